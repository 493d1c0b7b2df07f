"""Sweeps over hyperparameters by Optuna, in batches through one program."""

from ._evaluate import evaluate as evaluate
from ._plot import plot_sweep as plot_sweep
from ._space import Interval as Interval, Space as Space
from ._sweep import Swept as Swept, sweep as sweep
