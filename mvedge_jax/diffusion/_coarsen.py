"""Operator-dependent coarsening: nine-point stencils, interpolation and the Galerkin product.

The coarse grid keeps the pixels with even coordinates. A kept pixel is a corner of a cell; each
other pixel lies on a horizontal side of a cell, on a vertical side, or inside. The three kinds
are `side_x`, `side_y` and `inside` below, arrays of the size of the coarse grid.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from mvedge_jax._cpu import no_fuse

from ._stencil import pad


class Stencil(NamedTuple):
    """A symmetric matrix: mass (row sums), and ties of a pixel to its eight neighbors.

    Row sums in place of the diagonal keep the edges of a weakly connected region, even a billion
    times weaker than the edges inside, from being lost to rounding.
    """

    mass: Array
    tx: Array
    ty: Array
    falling: Array | None  # (y, x) - (y + 1, x + 1)
    rising: Array | None  # (y, x + 1) - (y + 1, x)


class Interpolation(NamedTuple):
    """Weights of the corners of its cell for each fine pixel."""

    side_x: tuple[Array, Array]
    side_y: tuple[Array, Array]
    inside: tuple[Array, Array, Array, Array]


def ties(stencil: Stencil, values: Array) -> Array:
    """Sum of the eight neighbors, each times the weight of its edge."""
    total = (
        pad(stencil.tx * values[..., 1:], (0, 0), (0, 1))
        + pad(stencil.tx * values[..., :-1], (0, 0), (1, 0))
        + pad(stencil.ty * values[..., 1:, :], (0, 1), (0, 0))
        + pad(stencil.ty * values[..., :-1, :], (1, 0), (0, 0))
    )
    if stencil.falling is None or stencil.rising is None:
        return total
    return (
        total
        + pad(stencil.falling * values[..., 1:, 1:], (0, 1), (0, 1))
        + pad(stencil.falling * values[..., :-1, :-1], (1, 0), (1, 0))
        + pad(stencil.rising * values[..., :-1, 1:], (1, 0), (0, 1))
        + pad(stencil.rising * values[..., 1:, :-1], (0, 1), (1, 0))
    )


def degree(stencil: Stencil) -> Array:
    """The diagonal."""
    return stencil.mass + ties(stencil, jnp.ones_like(stencil.mass))


def product(stencil: Stencil, values: Array) -> Array:
    """The matrix times `values`, from differences."""
    along_x = stencil.tx * (values[..., 1:] - values[..., :-1])
    along_y = stencil.ty * (values[..., 1:, :] - values[..., :-1, :])
    total = stencil.mass * values
    total = total - pad(along_x, (0, 0), (0, 1)) + pad(along_x, (0, 0), (1, 0))
    total = total - pad(along_y, (0, 1), (0, 0)) + pad(along_y, (1, 0), (0, 0))
    if stencil.falling is None or stencil.rising is None:
        return total
    falling = stencil.falling * (values[..., 1:, 1:] - values[..., :-1, :-1])
    rising = stencil.rising * (values[..., 1:, :-1] - values[..., :-1, 1:])
    total = total - pad(falling, (0, 1), (0, 1)) + pad(falling, (1, 0), (1, 0))
    return total - pad(rising, (0, 1), (1, 0)) + pad(rising, (1, 0), (0, 1))


def interpolate(weights: Interpolation, corners: Array, shape: tuple[int, ...]) -> Array:
    """From corners to all pixels."""
    right, below = after_x(corners), after_y(corners)
    (west, east), (north, south) = weights.side_x, weights.side_y
    nw, ne, sw, se = weights.inside
    return interleave(
        corners,
        west * corners + east * right,
        north * corners + south * below,
        nw * corners + ne * right + sw * below + se * after_x(below),
        shape,
    )


def restrict(weights: Interpolation, values: Array) -> Array:
    """The transpose of `interpolate`."""
    corners, side_x, side_y, inside = split(values)
    (west, east), (north, south) = weights.side_x, weights.side_y
    nw, ne, sw, se = weights.inside
    return (
        corners
        + west * side_x
        + before_x(east * side_x)
        + north * side_y
        + before_y(south * side_y)
        + nw * inside
        + before_x(ne * inside)
        + before_y(sw * inside)
        + before_y(before_x(se * inside))
    )


class _Fine(NamedTuple):
    """The edges of the fine grid by the kinds of their ends.

    Letters are the ends from left to right and top to bottom: `c`orner, side `h` (horizontal),
    side `v` (vertical), inside `x`.
    """

    c_h: Array
    h_c: Array
    v_x: Array
    x_v: Array
    c_v: Array
    h_x: Array
    v_c: Array
    x_h: Array
    c_x: Array
    h_v: Array
    v_h: Array
    x_c: Array
    h_v_rising: Array
    c_x_rising: Array
    x_c_rising: Array
    v_h_rising: Array
    mass_x: Array
    mass_y: Array
    mass_inside: Array


def _fine(stencil: Stencil) -> _Fine:
    shape = stencil.mass.shape[-2:]
    none = jnp.zeros_like(stencil.mass)
    falling = none if stencil.falling is None else fill(stencil.falling, shape)
    rising = none if stencil.rising is None else fill(stencil.rising, shape)
    return _Fine(
        *split(fill(stencil.tx, shape)),
        *split(fill(stencil.ty, shape)),
        *split(falling),
        *split(rising),
        *split(stencil.mass)[1:],
    )


def coarsen(stencil: Stencil) -> tuple[Stencil, Interpolation]:
    """Interpolation that follows the edge weights, and the matrix on the coarse grid.

    On a side, the tie to each corner is the sum of all edges that lead to its half, and the edges
    along the other direction are left out; inside, the pixel's own equation is solved. At a data
    weight the interpolation weights sum to less than 1, which holds corrections at zero at strong
    data. The pixels inside have no residual after interpolation, so that the Galerkin product
    needs only the sides (Dendy 1982, black-box multigrid).
    """
    weights, shortfall = no_fuse(_weights, stencil)
    leak = no_fuse(lambda: stencil.mass - product(stencil, shortfall))
    return no_fuse(_galerkin, stencil, weights, shortfall, leak), weights


def _weights(stencil: Stencil) -> tuple[Interpolation, Array]:
    """Interpolation, and one minus the sum of each fine pixel's weights."""
    fine = _fine(stencil)
    west = fine.c_h + fine.h_v_rising + before_y(fine.v_h)
    east = fine.h_c + fine.h_v + before_y(fine.v_h_rising)
    total = west + east + fine.mass_x
    west, east, short_x = (ratio(a, total) for a in (west, east, fine.mass_x))

    north = fine.c_v + fine.h_v_rising + before_x(fine.h_v)
    south = fine.v_c + fine.v_h + before_x(fine.v_h_rising)
    total = north + south + fine.mass_y
    north, south, short_y = (ratio(a, total) for a in (north, south, fine.mass_y))

    middle = _middle(fine)
    short = (
        fine.mass_inside
        + fine.h_x * short_x
        + fine.x_h * after_y(short_x)
        + fine.v_x * short_y
        + fine.x_v * after_x(short_y)
    )
    inside = (
        fine.c_x + fine.h_x * west + fine.v_x * north,
        fine.c_x_rising + fine.h_x * east + fine.x_v * after_x(north),
        fine.x_c_rising + fine.x_h * after_y(west) + fine.v_x * south,
        fine.x_c + fine.x_h * after_y(east) + fine.x_v * after_x(south),
    )
    nw, ne, sw, se = (ratio(a, middle) for a in inside)
    y, x = stencil.mass.shape[-2:]
    shortfall = interleave(jnp.zeros_like(west), short_x, short_y, ratio(short, middle), (y, x))
    return Interpolation((west, east), (north, south), (nw, ne, sw, se)), shortfall


def _middle(fine: _Fine) -> Array:
    """Diagonal of the pixels inside."""
    along = fine.v_x + fine.x_v + fine.h_x + fine.x_h
    return fine.mass_inside + along + fine.c_x + fine.x_c + fine.c_x_rising + fine.x_c_rising


def _galerkin(stencil: Stencil, weights: Interpolation, shortfall: Array, leak: Array) -> Stencil:
    """The matrix on the coarse grid.

    Off-diagonal entries are summed cell by cell, over the inside pixel, the four edges between
    sides, and the edges along the sides. Row sums are computed from the fine row sums, without
    cancellation.
    """
    fine = _fine(stencil)
    (west, east), (north, south) = weights.side_x, weights.side_y
    nw, ne, sw, se = weights.inside
    _, short_x, short_y, _ = split(shortfall)
    below_west, below_east = after_y(west), after_y(east)
    right_north, right_south = after_x(north), after_x(south)
    middle = _middle(fine)

    above = middle * nw * ne - fine.h_x * west * east
    below = middle * sw * se - fine.x_h * below_west * below_east
    left = middle * nw * sw - fine.v_x * north * south
    right = middle * ne * se - fine.x_v * right_north * right_south
    falls = middle * nw * se
    rises = middle * ne * sw
    if stencil.falling is not None:
        slope = north - west
        above = above + fine.h_v_rising * east * slope
        left = left - fine.h_v_rising * slope * south
        rises = rises + fine.h_v_rising * east * south
        slope = right_north - east
        above = above + fine.h_v * west * slope
        right = right - fine.h_v * slope * right_south
        falls = falls + fine.h_v * west * right_south
        slope = south - below_west
        below = below + fine.v_h * below_east * slope
        left = left - fine.v_h * slope * north
        falls = falls + fine.v_h * below_east * north
        slope = right_south - below_east
        below = below + fine.v_h_rising * below_west * slope
        right = right - fine.v_h_rising * slope * right_north
        rises = rises + fine.v_h_rising * below_west * right_north
    along_x = fine.c_h * (east + short_x) * east + fine.h_c * (west + short_x) * west
    along_y = fine.c_v * (south + short_y) * south + fine.v_c * (north + short_y) * north
    tx = above + before_y(below) + along_x - fine.mass_x * west * east
    ty = left + before_x(right) + along_y - fine.mass_y * north * south

    # Interpolation in strongly uneven cells makes some edges and row sums negative. Clipping them
    # adds to the matrix, so that corrections get smaller but never unstable, and every level has
    # the properties that the next one and the smoother need. With negative edges, float32
    # diverged on random smoothness of 1 and 1e-4.
    mass = restrict(weights, leak)
    return Stencil(
        jnp.maximum(mass, 0),
        jnp.maximum(tx[..., :-1], 0),
        jnp.maximum(ty[..., :-1, :], 0),
        jnp.maximum(falls[..., :-1, :-1], 0),
        jnp.maximum(rises[..., :-1, :-1], 0),
    )


def ratio(part: Array, whole: Array) -> Array:
    """`part / whole`, zero where `whole` is not positive."""
    return jnp.where(whole > 0, part / jnp.where(whole > 0, whole, 1), 0)


def fill(values: Array, shape: tuple[int, ...]) -> Array:
    """Pads the last two axes with zeros at their ends, up to `shape`."""
    y, x = values.shape[-2:]
    return pad(values, (0, shape[0] - y), (0, shape[1] - x))


def split(values: Array) -> tuple[Array, Array, Array, Array]:
    """Corners, horizontal sides, vertical sides and insides; odd sizes are padded with zeros."""
    y, x = values.shape[-2:]
    values = pad(values, (0, y % 2), (0, x % 2))
    return (
        values[..., 0::2, 0::2],
        values[..., 0::2, 1::2],
        values[..., 1::2, 0::2],
        values[..., 1::2, 1::2],
    )


def interleave(
    corners: Array, side_x: Array, side_y: Array, inside: Array, shape: tuple[int, ...]
) -> Array:
    """The inverse of `split`."""
    *batch, y, x = corners.shape
    even = jnp.stack([corners, side_x], axis=-1).reshape(*batch, y, 2 * x)
    odd = jnp.stack([side_y, inside], axis=-1).reshape(*batch, y, 2 * x)
    both = jnp.stack([even, odd], axis=-2).reshape(*batch, 2 * y, 2 * x)
    return both[..., : shape[0], : shape[1]]


def after_x(values: Array) -> Array:
    """The value of the next cell to the right, zero beyond the border."""
    return pad(values[..., 1:], (0, 0), (0, 1))


def after_y(values: Array) -> Array:
    """The value of the next cell below."""
    return pad(values[..., 1:, :], (0, 1), (0, 0))


def before_x(values: Array) -> Array:
    """The value of the cell to the left."""
    return pad(values[..., :-1], (0, 0), (1, 0))


def before_y(values: Array) -> Array:
    """The value of the cell above."""
    return pad(values[..., :-1, :], (1, 0), (0, 0))
