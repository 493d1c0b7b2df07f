"""Learning by gradient: numbers, arrays and networks of a model, from scenes."""

from ._choice import Choice as Choice, chosen as chosen
from ._learn import Learned as Learned, Progress as Progress, learn as learn
from ._loss import RobustLoss as RobustLoss, robust_loss as robust_loss
from ._plot import plot_learning as plot_learning
from ._scenes import of_one_range as of_one_range
