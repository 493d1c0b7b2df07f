"""EPI segments drawn into views, the nearest on top; colors; two directions put together."""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._crosshair import view_steps


class Ends(NamedTuple):
    """Segments of one direction, nearest last.

    Attributes:
        epi: number of the EPI.
        left: where the left border crosses the center view, and its disparity.
        right: the same of the right border.
        rank: place in the order from far to near, from 0 on.
    """

    epi: Float[Array, " n"]
    left: Float[Array, "n 2"]
    right: Float[Array, "n 2"]
    rank: Int[Array, " n"]

    @staticmethod
    def of(epi: np.ndarray, left: np.ndarray, right: np.ndarray) -> "Ends":
        """Of segments on the host; equals in their order."""
        rank = np.empty(len(epi), np.int32)
        rank[np.argsort(np.minimum(left[:, 1], right[:, 1]), kind="stable")] = np.arange(len(epi))
        first, last = jnp.asarray(left), jnp.asarray(right)
        return Ends(jnp.asarray(epi, first.dtype), first, last, jnp.asarray(rank))


def width_of(ends: Ends, reach: int) -> int:
    """Pixels that a segment has at most in a row of an EPI, views up to `reach` from the center."""
    gap = np.asarray(ends.right - ends.left)
    widest = np.max(gap[:, 0] + reach * np.abs(gap[:, 1]), initial=0.0)
    # Few programs for many scenes.
    return 16 * max(1, math.ceil((widest + 1) / 16))


def painted(
    ends: Ends,
    disparity: Float[Array, " n"],
    steps: Float[Array, "2"],
    *,
    shape: tuple[int, int],
    width: int,
    strict: bool = False,
) -> Int[Array, "e x"]:
    """Draws segments into a view.

    Args:
        ends: of the segments.
        disparity: by which they move to other EPIs.
        steps: `u_c - u` along the EPIs and `v_c - v` across them.
        shape: number of EPIs, pixels of each.
        width: from `width_of`.
        strict: draw the pixels between the lines only, none on the left one.

    Returns:
        The segment that each pixel shows, -1 for none.
    """
    count, size = shape
    left, right = (a[:, 0] + steps[0] * a[:, 1] for a in (ends.left, ends.right))
    row = jnp.floor(ends.epi + steps[1] * disparity + 0.5).astype(jnp.int32)
    first = jnp.floor(left) + 1 if strict else jnp.ceil(left)
    column = first[:, None] + jnp.arange(width, dtype=left.dtype)[None]
    inside = (row >= 0) & (row < count)
    covers = inside[:, None] & (column < right[:, None]) & (column >= 0) & (column < size)
    place = jnp.where(covers, row[:, None] * size + column.astype(jnp.int32), count * size)
    top = jnp.zeros(count * size + 1, jnp.int32)
    top = top.at[place].max(ends.rank[:, None] + 1, mode="promise_in_bounds")[:-1]
    order = jnp.zeros(ends.rank.size + 1, jnp.int32)
    order = order.at[ends.rank + 1].set(jnp.arange(ends.rank.size, dtype=jnp.int32))
    return jnp.where(top > 0, order[top], -1).reshape(shape)


def smoothed_labels(labels: Int[Array, "e x"], *, middle: bool) -> Int[Array, "e x"]:
    """Labels after a vote of three EPIs: that of two, or the own one where all differ.

    With `middle`, as the authors have it, the middle one of the three numbers, and 0 beyond the
    frame.
    """
    padded = jnp.pad(labels, ((1, 1), (0, 0)), mode="constant" if middle else "edge")
    before, after = padded[:-2], padded[2:]
    if middle:
        return jnp.median(jnp.stack([before, labels, after]), axis=0).astype(labels.dtype)
    return jnp.where(before == after, before, labels)


def agreed(across: Int[Array, "y x"], down: Int[Array, "y x"]) -> Int[Array, "y x"]:
    """Labels of both directions where they agree or one has none; 0 elsewhere."""
    same = (across == down) | (across == 0) | (down == 0)
    return jnp.where(same, jnp.maximum(across, down), 0)


@partial(jax.jit, static_argnames=("width", "strict"))
def mean_colors(
    lab: Float[Array, "u e x 3"], ends: Ends, *, width: int, strict: bool
) -> tuple[Float[Array, "n 3"], Bool[Array, " n"]]:
    """Mean colors of segments over the pixels of an arm that show them, and which are seen.

    Args:
        lab: of the views of the arm.
        ends: of the segments.
        width: from `width_of`.
        strict: see `painted`.
    """
    count, shape = ends.epi.size, (lab.shape[1], lab.shape[2])
    values = jnp.concatenate([lab, jnp.ones_like(lab[..., :1])], axis=-1)

    def add(sums: Array, item: tuple[Array, Array]) -> tuple[Array, None]:
        step, view = item
        steps = jnp.stack([step, 0 * step])
        nothing = jnp.zeros(count, step.dtype)
        index = painted(ends, nothing, steps, shape=shape, width=width, strict=strict)
        return sums.at[jnp.where(index < 0, count, index)].add(view), None

    steps = view_steps(lab.shape[0], lab.dtype)
    sums, _ = lax.scan(add, jnp.zeros((count + 1, 4), lab.dtype), (steps, values))
    mass = sums[:-1, 3:]
    return sums[:-1, :3] / jnp.maximum(mass, 1), mass[:, 0] > 0
