"""Plot of a finished sweep."""

import math

import numpy as np
import optuna
from matplotlib.figure import Figure
from optuna.trial import TrialState

from ._sweep import Swept


def plot_sweep(swept: Swept) -> Figure:
    """History, importance and slices of a sweep.

    Args:
        swept: a finished sweep.

    Returns:
        A figure with the score of every setting and the best so far; the importance of each number
        or choice among the better settings (PED-ANOVA), if there are enough settings; and the
        score over each number or choice with more than one value.
    """
    trials = [t for t in swept.study.get_trials() if t.state == TrialState.COMPLETE]
    number = np.asarray([t.number for t in trials])
    value = np.asarray([float(t.value or 0) for t in trials])
    names = [n for n in trials[0].params if len({t.params[n] for t in trials}) > 1]
    columns = 3
    rows = 1 + math.ceil(len(names) / columns)
    figure = Figure(figsize=(3.6 * columns, 2.8 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    history = figure.add_subplot(grid[0, :2])
    history.scatter(number, value, s=12, color="0.6", label="settings")
    history.step(number, np.minimum.accumulate(value), where="post", label="best so far")
    history.set(xlabel="setting", ylabel="mean score")
    history.legend(frameon=False)
    share = _importances(swept.study)
    bars = figure.add_subplot(grid[0, 2])
    share = {name: part for name, part in share.items() if name in names}
    bars.barh(list(share), list(share.values()))
    bars.set(xlabel="importance", xlim=(0, 1))
    for i, name in enumerate(names):
        axes = figure.add_subplot(grid[1 + i // columns, i % columns])
        values = [t.params[name] for t in trials]
        chosen = [isinstance(v, str) for v in values]
        axes.scatter(values, value, c=number, s=14, cmap="cividis")
        distribution = trials[0].distributions[name]
        if getattr(distribution, "log", False) and not any(chosen):
            axes.set_xscale("log")
        axes.axvline(swept.study.best_trial.params[name], color="C3", lw=0.8)
        axes.set(xlabel=name, ylabel="mean score")
    return figure


def _importances(study: optuna.Study) -> dict[str, float]:
    """Importances by PED-ANOVA; empty for too few settings."""
    evaluator = optuna.importance.PedAnovaImportanceEvaluator()
    try:
        return optuna.importance.get_param_importances(study, evaluator=evaluator)
    except (ValueError, RuntimeError):
        return {}
