"""The result of an optimization, and its validation by the views."""

from typing import NamedTuple

from jaxtyping import Array, Bool, Float

from ._model import DepthModel
from .optimization._optimize import History
from .optimization._state import State


class Verdict(NamedTuple):
    """Validation of a result by the views.

    Attributes:
        error: reprojection error (7.15) of every second view of the crosshair, before and after.
        kept: whether the change was kept.
        confirmed: share of one half's corrections that the other half of the views confirmed, in
            [0, 1]; None without such halves.
    """

    error: Float[Array, "2"]
    kept: Bool[Array, ""]
    confirmed: Float[Array, ""] | None = None


class Optimized(NamedTuple):
    """The result of `optimize_edges` or `fit_edges`.

    Attributes:
        disparity: the map, px per view step.
        model: the parameters with the lowest loss.
        history: loss and gradient per iteration.
        state: the state, to save and resume.
        verdict: validation of the map by the views; None for `fit_edges`.
    """

    disparity: Float[Array, "y x"]
    model: DepthModel
    history: History
    state: State
    verdict: Verdict | None = None
