"""EPI segments: which edge lines bound the same surface (Thesis 4.2.1, Alg. 2)."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy


class EpiSegments(NamedTuple):
    """Segments of an EPI between two of its lines.

    Attributes:
        right: index of the line on the right of the segment that each line begins; -1 for none.
        disparity: of the segment, that of the farther of its lines, px per view step; 0 for none.
    """

    right: Int[Array, " m"]
    disparity: Float[Array, " m"]


class _Relations(NamedTuple):
    """Between lines i (rows) and j (columns).

    Attributes:
        crosses: somewhere between the first and the last view.
        follows: j may be the right border of what i begins.
        affinity: (4.7).
    """

    crosses: Bool[Array, "m m"]
    follows: Bool[Array, "m m"]
    affinity: Float[Array, "m m"]


def _relations(
    position: Array, disparity: Array, valid: Array, share: Array | float, views: int
) -> _Relations:
    middle = views // 2
    # At the first and at the last view.
    first, last = position + middle * disparity, position - (views - 1 - middle) * disparity
    over, under = first[None] - first[:, None], last[None] - last[:, None]
    both = valid[:, None] & valid[None]
    own = jnp.eye(position.size, dtype=bool)
    slope = jnp.abs(disparity[:, None] - disparity[None])
    place = jnp.abs(position[:, None] - position[None])
    apart = share * (views - 1) * slope + (1 - share) * place
    return _Relations(
        (over * under <= 0) & both,
        both & ~own & ~((over < 0) & (under < 0)),
        # Equal lines are no reason to divide by 0.
        1 / (apart + 1e-6),
    )


@partial(jax.jit, static_argnames="reach")
def opening_sides(
    position: Float[Array, " m"],
    disparity: Float[Array, " m"],
    edges: Float[Array, "u x"],
    valid: Bool[Array, " m"],
    *,
    slope_share: Float[Array, ""] | float = 0.15,
    reach: int = 10,
) -> Int[Array, " m"]:
    """Tells to which side of an occluding line its surface is.

    Of two lines that cross, the nearer one belongs to the surface in front, and the farther one is
    seen on the side that this surface is not on: where edge pixels along it are. A line with
    different verdicts at different crossings opens towards the neighbor of more similar slope.

    Args:
        position: where lines cross the center view, px.
        disparity: of the lines, px per view step.
        edges: confidence of edges in the EPI, 0 where there is none.
        valid: lines to use.
        slope_share: of the slope in the affinity (4.7), against the place.
        reach: edge pixels this far from a crossing, in rows and columns, tell which side is hidden.

    Returns:
        Per line 1, it opens to the right; -1, to the left; 0, it occludes no other line.

    Source: Thesis 4.2.1, Alg. 2; ties of the count, which the authors' program opens to the left,
        go by slope as well.

    Example:
        >>> import jax.numpy as jnp
        >>> edges = jnp.zeros((9, 20)).at[:4, 10].set(1.0)
        >>> position, slope = jnp.array([10.0, 10.0]), jnp.array([0.0, 1.0])
        >>> opening_sides(position, slope, edges, jnp.array([True, True])).tolist()
        [0, 1]
    """
    views, width = edges.shape
    dtype = position.dtype
    related = _relations(position, disparity, valid, slope_share, views)
    nearer = disparity[:, None] - disparity[None]
    front = related.crosses & (nearer > 0)
    # Views from the center to the crossing of lines f and g.
    at = (position[None] - position[:, None]) / jnp.where(nearer == 0, 1, nearer)
    step = views // 2 - jnp.arange(views, dtype=dtype)
    column = jnp.round(position[:, None] + step[None] * disparity[:, None])
    inside = (column >= 0) & (column < width)
    index = jnp.where(inside, column, 0).astype(jnp.int32)
    marked = inside & (edges[jnp.arange(views)[None], index] > 0)
    # Line g (second axis) at every view (third axis), beside line f (first axis).
    beside = column[None] - column[:, None]
    crossing = position[:, None] + at * disparity[:, None]
    near = (jnp.abs(step[None, None] - at[..., None]) <= reach) & (
        jnp.abs(column[None] - crossing[..., None]) <= reach
    )
    counted = front[..., None] & near & marked[None]
    left = jnp.sum(counted & (beside < 0), axis=2, dtype=jnp.int32)
    right = jnp.sum(counted & (beside > 0), axis=2, dtype=jnp.int32)
    to_right, to_left = jnp.any(left > right, axis=1), jnp.any(right > left, axis=1)
    free = ~related.crosses & valid[:, None] & valid[None]
    gaps = []
    for side in (position[None] > position[:, None], position[None] < position[:, None]):
        affinity = jnp.where(free & side, related.affinity, 0)
        best = jnp.argmax(affinity, axis=1)
        gap = jnp.abs(disparity[best] - disparity)
        gaps.append(jnp.where(jnp.max(affinity, axis=1) > 0, gap, jnp.inf))
    similar = jnp.where(gaps[1] < gaps[0], -1, 1)
    sides = jnp.where(to_right == to_left, similar, jnp.where(to_right, 1, -1))
    return jnp.where(jnp.any(front, axis=1), sides, 0).astype(jnp.int32)


@accepts_numpy
def match_segments(
    position: Float[Array, " m"],
    disparity: Float[Array, " m"],
    opens: Int[Array, " m"],
    valid: Bool[Array, " m"],
    *,
    views: int,
    slope_share: Float[Array, ""] | float = 0.15,
) -> EpiSegments:
    """Pairs the lines of an EPI into segments, those in front first.

    Occluding lines are matched to the side that they open to, by the largest sum of affinities
    (4.7); what is left is matched afterwards, over crossings as well: a piece of background between
    its own line and the one that hides it is bounded by lines that cross.

    Args:
        position: where lines cross the center view, px.
        disparity: of the lines, px per view step.
        opens: from `opening_sides`.
        valid: lines to use.
        views: of the EPI, odd.
        slope_share: see `opening_sides`.

    Returns:
        The segments; every line begins one at most and ends one at most. Runs on the host, as the
        assignment is SciPy's; not differentiable.

    Raises:
        ValueError: if `views` is even or below 3.

    Source: Thesis 4.2.1, Alg. 2 and Eq. 4.7 with the missing half in the midpoints.

    Example:
        >>> import jax.numpy as jnp
        >>> position, disparity = jnp.array([0.0, 9.0]), jnp.array([0.0, 0.5])
        >>> opens, valid = jnp.array([0, 0]), jnp.array([True, True])
        >>> match_segments(position, disparity, opens, valid, views=9).right.tolist()
        [1, -1]
    """
    if views % 2 == 0 or views < 3:
        raise ValueError(f"`views` must be odd and at least 3, got {views}.")
    crosses, follows, affinity = (
        np.asarray(a) for a in _jitted(position, disparity, valid, slope_share, views=views)
    )
    sides = np.asarray(opens)
    right, left = sides > 0, sides < 0
    # No segment reaches beyond a surface in front that lies between its lines.
    between = (right[:, None] & left[None] & follows & ~crosses).astype(float)
    order = follows.astype(float)
    jumps = (order @ between > 0) | (between @ order > 0)
    first = follows & ~crosses & (right[:, None] | left[None]) & ~jumps
    found = _matched(np.where(first, affinity, 0))
    ends = np.zeros(sides.size, bool)
    ends[found[found >= 0]] = True
    rest = follows & (found < 0)[:, None] & ~ends[None]
    found = np.where(found < 0, _matched(np.where(rest, affinity, 0)), found)
    slopes = np.asarray(disparity)
    farther = np.where(found >= 0, np.minimum(slopes, slopes[found]), 0).astype(slopes.dtype)
    return EpiSegments(jnp.asarray(found, jnp.int32), jnp.asarray(farther))


_jitted = jax.jit(_relations, static_argnames="views")


def _matched(weights: np.ndarray) -> np.ndarray:
    """The column of each row in the matching of largest weight; -1 where there is none."""
    # Of SciPy's optimization, which takes long to import, nothing else is needed.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(weights, maximize=True)
    found = np.full(len(weights), -1)
    good = weights[rows, columns] > 0
    found[rows[good]] = columns[good]
    return found
