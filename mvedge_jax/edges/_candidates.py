"""Candidate pixels: those at which the filter bank or the center view alone finds an edge."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._root import safe_sqrt
from mvedge_jax.interpolation import exact_shift, vertex


class Candidates(NamedTuple):
    """Pixels on an edge, in raster order, which keeps the gathers of the refinement local.

    Attributes:
        row: y of each candidate.
        column: x of each candidate.
        valid: which slots hold a candidate.
        filtered: whether the filter response is a maximum along x, and along y.
        alone: whether only the contrast of the center view is a maximum.
        total: number of candidates.
        overflow: number of candidates without a slot.
    """

    row: Int[Array, " n"]
    column: Int[Array, " n"]
    valid: Bool[Array, " n"]
    filtered: Bool[Array, "2 n"]
    alone: Bool[Array, "2 n"]
    total: Int[Array, ""]
    overflow: Int[Array, ""]


def line_maxima(strength: Float[Array, "y x"], floor: Float[Array, ""]) -> Bool[Array, "y x"]:
    """Where a response is a local maximum along x, and above a floor."""
    left = jnp.pad(strength[:, :-1], ((0, 0), (1, 0)))
    right = jnp.pad(strength[:, 1:], ((0, 0), (0, 1)))
    return (strength > left) & (strength >= right) & (strength > floor)


def contrast(image: Float[Array, "y x c"]) -> Float[Array, "2 y x"]:
    """Central differences of one view along x and y, Euclidean norm over the channels."""

    def along(axis: int) -> Array:
        margin = [(0, 0), (0, 0), (0, 0)]
        margin[axis] = (1, 1)
        padded = jnp.pad(image, margin, mode="edge")
        size = image.shape[axis]
        ahead = jax.lax.slice_in_dim(padded, 2, size + 2, axis=axis)
        energy = ((ahead - jax.lax.slice_in_dim(padded, 0, size, axis=axis)) ** 2).sum(-1)
        return safe_sqrt(energy)

    return jnp.stack([along(1), along(0)])


def find_candidates(
    strength: Float[Array, "2 y x"],
    center: Float[Array, "2 y x"],
    floor: Float[Array, ""],
    center_floor: Float[Array, ""],
    *,
    capacity: int,
) -> Candidates:
    """Local maxima of the filter response or of the center view's contrast, along x or y.

    Near a crossing of lines, the stronger line raises the response of all filters that cross it, so
    the weaker line is no maximum there, although the center view shows it clearly.

    Args:
        strength: filter responses along x and along y.
        center: see `contrast`.
        floor: weakest response.
        center_floor: weakest contrast of the center view, whose noise is not averaged.
        capacity: number of slots; if there are more candidates, the weakest are dropped.
    """

    def maxima(values: Array, least: Array) -> Array:
        return jnp.stack([line_maxima(values[0], least), line_maxima(values[1].T, least).T])

    own = maxima(strength, floor)
    single = maxima(center, center_floor)
    strongest = jnp.where(own, strength, jnp.where(single, center, 0)).max(0)
    either = (own | single).any(0)
    count = either.sum()
    # If there are more candidates than slots, the weakest are dropped, not the last.
    if capacity < strongest.size:
        cut = jnp.sort(strongest.reshape(-1))[strongest.size - capacity - 1]
        either = either & ((count <= capacity) | (strongest > cut))
    row, column = (
        axis.astype(jnp.int32) for axis in jnp.nonzero(either, size=capacity, fill_value=0)
    )
    slots = either.sum()
    valid = jnp.arange(capacity, dtype=slots.dtype) < slots
    filtered = own[:, row, column] & valid[None]
    alone = single[:, row, column] & valid[None] & ~filtered
    return Candidates(row, column, valid, filtered, alone, count, count - slots)


def subpixel(
    strength: Float[Array, "2 y x"], center: Float[Array, "2 y x"], candidates: Candidates
) -> Float[Array, "n 2"]:
    """Vertex of a parabola through the response along each direction of a maximum."""
    row, column = candidates.row, candidates.column
    height, width = strength.shape[1:]

    def shift(values: Array) -> Array:
        def at(arm: int, down: int, right: int) -> Array:
            y = jnp.clip(row + down, 0, height - 1)
            x = jnp.clip(column + right, 0, width - 1)
            return values[arm, y, x]

        middle_x, middle_y = at(0, 0, 0), at(1, 0, 0)
        shift_x = jnp.clip(vertex(at(0, 0, -1), middle_x, at(0, 0, 1)), -0.5, 0.5)
        shift_y = jnp.clip(vertex(at(1, -1, 0), middle_y, at(1, 1, 0)), -0.5, 0.5)
        return jnp.stack([shift_x, shift_y])

    moved = jnp.where(candidates.filtered, shift(strength), 0)
    moved = jnp.where(candidates.alone, shift(center), moved)
    pixel = jnp.stack([column, row], -1).astype(moved.dtype)
    return pixel + exact_shift(moved.T)
