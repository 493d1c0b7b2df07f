"""How much a disparity map changes where a video does not."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax.image import box_mean

# A pixel is unchanged if the mean square of the differences in the window around it, over all
# channels, is at most this many times what noise alone gives.
_RADIUS, _FACTOR = 2, 2.0


class TemporalConsistency(NamedTuple):
    """Change between the disparity maps of two frames; see `temporal_consistency`.

    Attributes:
        unchanged: Share of pixels whose surroundings look the same in both frames, and whose
            disparity is finite in both.
        change: Mean absolute change of disparity there, px per view step; NaN if there are none.
        changed_07: Percentage of them whose disparity changes by more than .07 px.
    """

    unchanged: Float[Array, ""]
    change: Float[Array, ""]
    changed_07: Float[Array, ""]


@accepts_numpy
def temporal_consistency(
    disparity: Float[Array, "y x"],
    before: Float[Array, "y x"],
    view: Float[Array, "y x c"],
    view_before: Float[Array, "y x c"],
    *,
    noise: float | Float[Array, ""] = 1 / 255 / 12**0.5,
) -> TemporalConsistency:
    """Change of the disparity between two frames of a video, where the views show no change.

    A pixel is *unchanged* if the mean squared difference of colors in the 5x5 pixels around it is
    at most twice that of noise. What looks the same has the same depth as a rule; but a plain
    surface may move without a trace, and a moving camera leaves little unchanged. A constant map
    never changes: read the figures beside the error of the maps.

    Args:
        disparity: Of the later frame, `[y, x]`, px per view step.
        before: Of the earlier frame.
        view: Center view of the later frame, `[y, x, c]`, in [0, 1].
        view_before: Center view of the earlier frame.
        noise: Standard deviation of a channel of either view, traced; by default that of the
            rounding to 8 bits.

    Returns:
        The share of unchanged pixels, and the change there. Differentiable in both maps.

    Raises:
        ValueError: Shapes do not fit.

    Example:
        >>> view = jnp.full((8, 8, 3), 0.5)
        >>> found = temporal_consistency(jnp.zeros((8, 8)), jnp.full((8, 8), 0.25), view, view)
        >>> found.unchanged.item(), found.change.item(), found.changed_07.item()
        (1.0, 0.25, 100.0)
    """
    if disparity.ndim != 2 or before.shape != disparity.shape:
        raise ValueError(
            "`disparity` and `before` must be maps [y, x] of one size, got shapes "
            f"{disparity.shape} and {before.shape}."
        )
    if view.ndim != 3 or view.shape[:2] != disparity.shape or view_before.shape != view.shape:
        raise ValueError(
            f"`view` and `view_before` must be images [y, x, c] of the maps' size "
            f"{disparity.shape}, got shapes {view.shape} and {view_before.shape}."
        )
    return _change(disparity, before, view, view_before, jnp.asarray(noise, view.dtype))


@jax.jit
def _change(
    disparity: Array, before: Array, view: Array, view_before: Array, noise: Array
) -> TemporalConsistency:
    differs = box_mean(jnp.mean((view - view_before) ** 2, axis=-1), _RADIUS)
    known = jnp.isfinite(disparity) & jnp.isfinite(before)
    same = known & (differs <= _FACTOR * 2 * noise**2)
    change = jnp.abs(jnp.where(same, disparity - before, 0))
    count = jnp.sum(same, dtype=jnp.int32).astype(disparity.dtype)
    return TemporalConsistency(
        count / same.size,
        jnp.sum(change) / count,
        100 * jnp.sum(change > 0.07, dtype=jnp.int32).astype(disparity.dtype) / count,
    )
