"""The surroundings of holes in a reprojected map."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy


class Holes(NamedTuple):
    """The surroundings of the holes of a map.

    Attributes:
        behind: flat index of the farthest of the nearest pixels to the left, to the right, above
            and below; where there are none, as in the corner of a map that moved away from it, that
            of the pixels above and below in the nearest rows that are not empty. The pixel itself
            where there is no hole, 0 where the map is empty.
        spread: difference of these four, px, or of those of the pixel above or below; 0 outside of
            holes.
        crack: holes of one pixel between two that differ by at most the tolerance.
    """

    behind: Int[Array, "y x"]
    spread: Float[Array, "y x"]
    crack: Bool[Array, "y x"]


@accepts_numpy
def holes(
    disparity: Float[Array, "y x"],
    hit: Bool[Array, "y x"],
    *,
    tolerance: Float[Array, ""] | float = 0.1,
) -> Holes:
    """Finds the pixels around the holes of a map, in which the surface behind usually continues.

    Args:
        disparity: px per view step, larger is nearer; read only where `hit`.
        hit: pixels that have one.
        tolerance: largest difference within one surface, px.

    Returns:
        Indices of the source pixels. A selection: no gradient passes.

    Example:
        >>> import jax.numpy as jnp
        >>> row = jnp.array([[2.0, 0.0, 0.0, 1.0]])
        >>> holes(row, row > 0).behind.tolist()
        [[0, 3, 3, 3]]
    """
    disparity = lax.stop_gradient(disparity)
    width = disparity.shape[1]
    rows, columns = jnp.indices(disparity.shape, dtype=jnp.int32)
    own = rows * width + columns
    flat = disparity.ravel()
    behind, crack = jnp.where(hit, own, 0), jnp.zeros_like(hit)
    least, most = (jnp.full_like(disparity, sign * jnp.inf) for sign in (1, -1))
    for axis, place in ((1, columns), (0, rows)):
        beside = []
        for reverse in (False, True):
            last, there = _last(hit, place, axis, reverse=reverse)
            source = rows * width + last if axis == 1 else last * width + columns
            value = jnp.where(there, flat[source], jnp.inf)
            behind = jnp.where(~hit & (value < least), source, behind)
            least = jnp.minimum(least, value)
            most = jnp.where(there, jnp.maximum(most, value), most)
            beside.append((value, there & (jnp.abs(last - place) == 1)))
        (first, one), (second, other) = beside
        crack = crack | (one & other & (jnp.abs(first - second) <= tolerance))
    spread = jnp.where(~hit & (most >= least), most - least, 0)
    # Every pixel of a row with a hit has a source by now: where one has none, its row is empty, and
    # the nearest row that is not is the same for all of its pixels.
    nearest, known = jnp.where(hit, disparity, least), jnp.any(hit, axis=1)
    lacks, farthest = ~hit & ~jnp.isfinite(least), jnp.full_like(disparity, jnp.inf)
    for reverse in (False, True):
        last, there = _last(known[:, None], rows[:, :1], 0, reverse=reverse)
        value = jnp.where(there, nearest[last[:, 0]], jnp.inf)
        takes = lacks & (value < farthest)
        behind = jnp.where(takes, behind[last[:, 0]], behind)
        spread = jnp.where(takes, spread[last[:, 0]], spread)
        farthest = jnp.minimum(farthest, value)
    return Holes(behind, spread, ~hit & crack)


def _last(hit: Array, place: Array, axis: int, *, reverse: bool) -> tuple[Array, Array]:
    """Coordinate of the nearest hit to one side, and whether there is one."""
    if axis == 1:
        last, there = _last(hit.T, place.T, 0, reverse=reverse)
        return last.T, there.T
    end = hit.shape[0]
    outside, nearer = (end, jnp.minimum) if reverse else (-1, jnp.maximum)

    # Row by row: on the CPU, XLA makes a cumulative extremum of many small images.
    def further(last: Array, here: Array) -> tuple[Array, Array]:
        last = nearer(last, here)
        return last, last

    start = jnp.full(hit.shape[1], outside, place.dtype)
    _, last = lax.scan(further, start, jnp.where(hit, place, outside), reverse=reverse)
    there = (last >= 0) & (last < end)
    return jnp.where(there, last, 0), there
