"""What an optimisation found, and what the views say of it."""

from typing import NamedTuple

from jaxtyping import Array, Bool, Float

from ._model import DepthModel
from .optimisation._optimise import History
from .optimisation._state import State


class Verdict(NamedTuple):
    """What the views say of a result.

    Attributes:
        error: reprojection error (7.15) of every second view of the crosshair, before and after.
        kept: whether the change was kept.
        confirmed: how much of what one half of the views proposed the other confirmed, in [0, 1];
            None if they were not asked so.
    """

    error: Float[Array, "2"]
    kept: Bool[Array, ""]
    confirmed: Float[Array, ""] | None = None


class Optimised(NamedTuple):
    """What `optimize_edges` or `fit_edges` found.

    Attributes:
        disparity: the map, px per view step.
        model: the parameters with the lowest loss.
        history: loss and gradient per iteration.
        state: to save and to go on from.
        verdict: what the views say of the map; None if they were not asked.
    """

    disparity: Float[Array, "y x"]
    model: DepthModel
    history: History
    state: State
    verdict: Verdict | None = None
