"""The curves of learning, as a picture."""

import numpy as np
from matplotlib.figure import Figure

from ._learn import Learned


def plot_learning(learned: Learned, *, most: int = 12) -> Figure:
    """Draws losses over steps, and the numbers that moved most.

    Args:
        learned: a finished run.
        most: numbers to show.

    Returns:
        The figure: the loss of every minibatch with its running mean, the validation loss where
        there is one, and the factors by which single numbers changed.
    """
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    curve, bars = figure.subplots(1, 2, width_ratios=(3, 2))
    losses = learned.losses
    steps = np.arange(1, len(losses) + 1)
    curve.plot(steps, losses, ".", markersize=3, color="0.7", label="minibatch")
    width = max(len(losses) // 20, 1)
    if len(losses) >= 2 * width > 2:
        mean = np.convolve(losses, np.full(width, 1 / width), mode="valid")
        curve.plot(steps[width - 1 :], mean, color="C0", label=f"mean of {width} minibatches")
    if len(learned.validation):
        checked, values = zip(*learned.validation, strict=True)
        curve.plot(checked, values, "o-", markersize=3, color="C3", label="validation")
        curve.axvline(learned.best_step, color="C3", lw=0.8, ls=":")
    curve.set(xlabel="step", ylabel="loss")
    curve.legend(frameon=False)
    changes = sorted(learned.factors().items(), key=lambda pair: abs(np.log(pair[1])))[-most:]
    bars.barh([name for name, _ in changes], [factor - 1 for _, factor in changes])
    bars.axvline(0, color="0.3", lw=0.6)
    bars.tick_params(axis="y", labelsize=6)
    bars.set(xlabel="relative change of a number")
    return figure
