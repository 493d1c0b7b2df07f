"""The search over disparities at every pixel: filter responses and windowed photo-consistency.

Both are sums along the same lines, hence convolutions along the arm with the views as channels,
and both are wanted only as a few maps. So one pass over square tiles computes them: the volumes
over all disparities never exist for more than one tile.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ._bank import FilterBank, line_taps
from ._response import correlate


class Maps(NamedTuple):
    """What the search keeps per pixel of the centre view; axis 0 is the arm (horizontal first).

    Attributes:
        strength: largest response over the filters, Euclidean norm over colour channels.
        peak: disparity of that response, interpolated between neighbouring filters.
        disparity: disparity of the best windowed photo-consistency of both arms, interpolated.
        cost: its saturated cost, 0 (all views agree) to 1.
    """

    strength: Float[Array, "2 y x"]
    peak: Float[Array, "2 y x"]
    disparity: Float[Array, "y x"]
    cost: Float[Array, "y x"]


def vertex(below: Array, middle: Array, above: Array) -> Array:
    """Offset of the extremum of the parabola through three values at -1, 0 and 1, in [-1, 1]."""
    bend = below - 2 * middle + above
    flat = jnp.abs(bend) <= 1e-6 * (jnp.abs(below) + jnp.abs(above)) + 1e-30
    offset = 0.5 * (below - above) / jnp.where(flat, 1, bend)
    return jnp.where(flat, 0, jnp.clip(offset, -1, 1))


def interpolated(values: Float[Array, "y x k"], best: Array, disparity: Array) -> Array:
    """Disparity of the extremum next to index `best`, from a parabola through three filters."""
    last = disparity.shape[0] - 1
    inner = jnp.clip(best, min(1, last), max(last - 1, 0))

    def at(index: Array) -> Array:
        index = jnp.clip(index, 0, last)
        return jnp.take_along_axis(values, index[..., None], -1)[..., 0]

    offset = vertex(at(inner - 1), at(inner), at(inner + 1))
    left = disparity[jnp.clip(inner - 1, 0, last)]
    right = disparity[jnp.clip(inner + 1, 0, last)]
    # Equal spacing on either side is assumed within the parabola, as in any graded bank.
    return disparity[inner] + 0.5 * offset * (right - left)


def box_sum(values: Array, window: int, axis: int) -> Array:
    """Sum over `window` neighbours along an axis; only where the window fits."""
    count = values.shape[axis] - window + 1
    return sum(
        (lax.slice_in_dim(values, i, i + count, axis=axis) for i in range(1, window)),
        lax.slice_in_dim(values, 0, count, axis=axis),
    )


class _Lines(NamedTuple):
    """Taps for sums along lines: of values, and of squared differences (see `_variance`)."""

    line: Float[Array, "k u w"]
    mixed: Float[Array, "k u w"]


def _line_taps(disparity: Array, views: int, radius: int) -> _Lines:
    steps = jnp.asarray(views // 2 - np.arange(views), disparity.dtype)
    position = disparity[:, None] * steps[None]
    whole = jnp.floor(position)
    part = position - whole
    offsets = jnp.arange(-radius, radius + 1, dtype=disparity.dtype)
    mixed = (
        jnp.where(offsets[None, None] == whole[..., None], (part * (1 - part))[..., None], 0)
        / views
    )
    return _Lines(line_taps(disparity, views, radius), mixed)


def _variance(rows: Array, known: Array, taps: _Lines, radius: int) -> Array:
    """Variance over the views along every line: [row, x, disparity].

    The square of a linear interpolation is the interpolation of the squares less
    `f (1 - f) (difference)^2`: so sums of squares of *interpolated* samples are convolutions too.
    Samples outside the image count as missing, not as copies of the border.

    Args:
        rows: grey values [row, x, view], zero outside the image.
        known: 1 inside the image [x, view], 0 outside.
        taps: line sums.
        radius: reach of the taps.
    """
    both = known[1:] * known[:-1]
    steps = jnp.pad((rows[:, 1:] - rows[:, :-1]) * both[None], ((0, 0), (0, 1), (0, 0)))
    squares = jnp.concatenate([rows * rows, steps * steps], axis=-1)
    square_taps = jnp.concatenate([taps.line, -taps.mixed], axis=1)
    weight = jnp.maximum(correlate(known[None], taps.line), 1e-3)
    mean = correlate(rows, taps.line) / weight
    # Rounding can leave a tiny negative number where all views agree.
    return jnp.maximum(correlate(squares, square_taps) / weight - mean * mean, 0)


def search(
    lab: tuple[Float[Array, "u y x c"], Float[Array, "v x y c"]],
    gray: tuple[Float[Array, "u y x"], Float[Array, "v x y"]],
    banks: tuple[FilterBank, FilterBank],
    saturation: Float[Array, ""],
    *,
    window: int,
    tile: int,
) -> Maps:
    """Finds the best filter of either arm and the most consistent disparity at every pixel.

    The consistency of a disparity is the variance over the views of an arm, saturated as
    `v / (v + saturation)` so that one strong edge in the window does not decide for its
    neighbours, averaged over the window and added over both arms.

    Args:
        lab: the views of the arms, the vertical one with x and y swapped, for the filters.
        gray: the same in grey, for the consistency.
        banks: filters of the horizontal and of the vertical arm, of the same disparities.
        saturation: variance (grey levels squared) at which the cost is one half.
        window: side of the window, odd, px.
        tile: side of the tiles, px.

    Returns:
        The maps. Differentiable in all arguments at the winners, which are discrete.
    """
    height, width = gray[0].shape[1:]
    disparity = banks[0].disparity
    radius = banks[0].radius
    half = window // 2
    reach = radius + half + 1
    sides = (height, width)
    tile_rows, tile_columns = -(-height // tile), -(-width // tile)

    def prepare(colour: Array, grey: Array, rows: int, columns: int) -> tuple[Array, ...]:
        """Pads an arm to whole tiles with a margin; channels and views last."""
        spare_rows = -(-rows // tile) * tile - rows
        spare_columns = -(-columns // tile) * tile - columns
        margin = ((half, half + spare_rows), (reach, reach + spare_columns))
        colour = jnp.pad(colour, ((0, 0), *margin, (0, 0)), mode="edge")
        grey = jnp.pad(grey, ((0, 0), margin[0], (0, 0)), mode="edge")
        # One pixel beyond the border still counts: lines may end between two pixels.
        known = np.zeros(columns + 2 * reach + spare_columns)
        known[reach - 1 : reach + columns + 1] = 1
        known = jnp.asarray(known, grey.dtype)
        grey = jnp.pad(grey, ((0, 0), (0, 0), margin[1]), mode="edge") * known[None, None]
        return jnp.transpose(colour, (1, 3, 2, 0)), jnp.transpose(grey, (1, 2, 0)), known

    arms = (
        prepare(lab[0], gray[0], height, width),
        prepare(lab[1], gray[1], width, height),
    )
    lines = tuple(
        _line_taps(b.disparity, g.shape[0], radius) for b, g in zip(banks, gray, strict=True)
    )

    def arm_tile(which: int, row: Array, column: Array) -> tuple[Array, Array, Array]:
        colour, grey, known = arms[which]
        views = grey.shape[-1]
        channels = colour.shape[1]
        inner = (tile, channels, tile + 2 * radius, views)
        zero = jnp.zeros((), row.dtype)
        patch = lax.dynamic_slice(colour, (row + half, zero, column + half + 1, zero), inner)
        response = correlate(patch.reshape(-1, *inner[2:]), banks[which].taps)
        energy = (response**2).reshape(tile, channels, tile, -1).sum(1)
        best = jnp.argmax(energy, -1)
        strongest = jnp.take_along_axis(energy, best[..., None], -1)[..., 0]
        # The root has no slope at 0: a flat patch must not give NaN gradients.
        strength = jnp.where(strongest > 0, jnp.sqrt(jnp.where(strongest > 0, strongest, 1)), 0)
        wide = tile + 2 * half
        outer = (wide, wide + 2 * radius, views)
        rows = lax.dynamic_slice(grey, (row, column + 1, zero), outer)
        inside = lax.dynamic_slice(known, (column + 1,), (outer[1],))
        inside = jnp.broadcast_to(inside[:, None], outer[1:])
        variance = _variance(rows, inside, lines[which], radius)
        return strength, interpolated(energy, best, disparity), variance

    @jax.checkpoint
    def one(index: Array) -> tuple[Array, ...]:
        row, column = index // tile_columns * tile, index % tile_columns * tile
        strength_h, peak_h, variance_h = arm_tile(0, row, column)
        strength_v, peak_v, variance_v = arm_tile(1, column, row)
        variance_v = jnp.swapaxes(variance_v, 0, 1)
        cost = variance_h / (variance_h + saturation) + variance_v / (variance_v + saturation)
        cost = box_sum(box_sum(cost, window, 0), window, 1) / (2 * window * window)
        best = jnp.argmin(cost, -1)
        lowest = jnp.take_along_axis(cost, best[..., None], -1)[..., 0]
        return (
            jnp.stack([strength_h, strength_v.T]),
            jnp.stack([peak_h, peak_v.T]),
            interpolated(cost, best, disparity),
            lowest,
        )

    strength, peak, best, lowest = lax.map(
        one, jnp.arange(tile_rows * tile_columns, dtype=jnp.int32)
    )

    def assemble(tiles: Array) -> Array:
        lead = tiles.shape[1:-2]
        grid = tiles.reshape(tile_rows, tile_columns, *lead, tile, tile)
        grid = jnp.moveaxis(grid, (0, 1), (-4, -2))
        image = grid.reshape(*lead, tile_rows * tile, tile_columns * tile)
        return image[..., : sides[0], : sides[1]]

    return Maps(assemble(strength), assemble(peak), assemble(best), assemble(lowest))
