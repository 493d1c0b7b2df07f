"""The thesis' preconditioner: a locally adapted hierarchical basis (LAHBPCG)."""

from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Array

from mvedge_jax._cpu import no_fuse
from mvedge_jax.diffusion import Coefficients
from mvedge_jax.diffusion._coarsen import (
    after_x,
    after_y,
    before_x,
    before_y,
    fill,
    interleave,
    ratio,
    split,
)


class Octave(NamedTuple):
    """One octave, in the kinds of pixels that `mvedge_jax.diffusion._coarsen` names.

    Attributes:
        side_x: shares of a pixel on a horizontal side: left, right corner, upper, lower inside.
        side_y: the same on a vertical side: upper, lower corner, left, right inside.
        inside: shares of an inside pixel: its four corners.
        pivots: diagonals at elimination, of side_x, side_y and inside.
    """

    side_x: tuple[Array, ...]
    side_y: tuple[Array, ...]
    inside: tuple[Array, ...]
    pivots: tuple[Array, ...]


class Basis(NamedTuple):
    """All octaves, finest first, and the sum of data weights that is left of them."""

    octaves: tuple[Octave, ...]
    rest: Array


def build(coefficients: Coefficients) -> Basis:
    """Eliminates every other pixel, half an octave at a time.

    Eliminating a pixel ties its four neighbors to each other. The ties between opposite
    neighbors are dropped, and twice their weight goes to the four others in proportion to their
    strength. Rows keep their sums, which are carried instead of diagonals.
    """
    octaves = []
    while max(coefficients.weight.shape[-2:]) > 1:
        octave, coefficients = no_fuse(_octave, coefficients)
        octaves.append(octave)
    return Basis(tuple(octaves), coefficients.weight)


def _eliminate(
    mass: Array, ties: tuple[Array, ...]
) -> tuple[tuple[Array, ...], Array, tuple[Array, ...]]:
    """Eliminates pixels tied to four neighbors, given in pairs of opposite ones: a, b; c, d.

    Returns:
        Shares, pivot, and the new ties a-c, a-d, b-c, b-d.
    """
    pivot = mass + ties[0] + ties[1] + ties[2] + ties[3]
    a, b, c, d = (ratio(tie, pivot) for tie in ties)
    ring = tuple(pivot * i * j for i, j in ((a, c), (a, d), (b, c), (b, d)))
    dropped = pivot * (a * b + c * d)
    grown = 1 + 2 * ratio(dropped, ring[0] + ring[1] + ring[2] + ring[3])
    return (a, b, c, d), pivot, tuple(grown * tie for tie in ring)


def _octave(coefficients: Coefficients) -> tuple[Octave, Coefficients]:
    weight, tx, ty = coefficients
    shape = weight.shape[-2:]
    corners, mass_x, mass_y, mass_inside = split(weight)
    c_h, h_c, v_x, x_v = split(fill(tx, shape))
    c_v, h_x, v_c, x_h = split(fill(ty, shape))

    side_x, pivot_x, ring_x = _eliminate(mass_x, (c_h, h_c, before_y(x_h), h_x))
    side_y, pivot_y, ring_y = _eliminate(mass_y, (c_v, v_c, before_x(x_v), v_x))
    west_up, west_down, east_up, east_down = ring_x
    north_left, north_right, south_left, south_right = ring_y
    corners = corners + _gather_corners(side_x, side_y, mass_x, mass_y)
    mass_inside = mass_inside + _gather_inside(side_x, side_y, mass_x, mass_y)

    nw = west_down + north_right
    se = after_y(east_up) + after_x(south_left)
    ne = east_down + after_x(north_left)
    sw = after_y(west_up) + south_right
    inside, pivot, ring = _eliminate(mass_inside, (nw, se, ne, sw))
    above, left, right, below = ring
    corners = corners + _gather_diagonal(inside, mass_inside)
    coarse = Coefficients(
        corners, (above + before_y(below))[..., :-1], (left + before_x(right))[..., :-1, :]
    )
    return Octave(side_x, side_y, inside, (pivot_x, pivot_y, pivot)), coarse


def _gather_corners(side_x: tuple, side_y: tuple, values_x: Array, values_y: Array) -> Array:
    return (
        side_x[0] * values_x
        + before_x(side_x[1] * values_x)
        + side_y[0] * values_y
        + before_y(side_y[1] * values_y)
    )


def _gather_inside(side_x: tuple, side_y: tuple, values_x: Array, values_y: Array) -> Array:
    return (
        after_y(side_x[2] * values_x)
        + side_x[3] * values_x
        + after_x(side_y[2] * values_y)
        + side_y[3] * values_y
    )


def _gather_diagonal(inside: tuple, values: Array) -> Array:
    nw, se, ne, sw = (share * values for share in inside)
    return nw + before_y(before_x(se)) + before_x(ne) + before_y(sw)


def solver(basis: Basis) -> Callable[[Array], Array]:
    """The product with the inverse of the incomplete factors."""
    return lambda residual: _solve(basis.octaves, basis.rest, residual)


def _solve(octaves: tuple[Octave, ...], rest: Array, residual: Array) -> Array:
    if not octaves:
        return ratio(residual, rest)
    octave, *coarser = octaves
    side_x, side_y, inside, _ = octave

    def down() -> tuple[Array, Array]:
        corners, right_x, right_y, middle = split(residual)
        corners = corners + _gather_corners(side_x, side_y, right_x, right_y)
        middle = middle + _gather_inside(side_x, side_y, right_x, right_y)
        return corners + _gather_diagonal(inside, middle), middle

    coarse, middle = no_fuse(down)
    corners = _solve(tuple(coarser), rest, coarse)
    shape = residual.shape[-2:]

    def center() -> Array:
        nw, se, ne, sw = inside
        beside, below = after_x(corners), after_y(corners)
        value = nw * corners + se * after_x(below) + ne * beside + sw * below
        return value + ratio(middle, octave.pivots[2])

    middles = no_fuse(center)

    def sides() -> Array:
        _, right_x, right_y, _ = split(residual)
        west, east, up, down = side_x
        on_x = west * corners + east * after_x(corners) + up * before_y(middles) + down * middles
        north, south, left, right = side_y
        on_y = north * corners + south * after_y(corners)
        on_y = on_y + left * before_x(middles) + right * middles
        on_x = on_x + ratio(right_x, octave.pivots[0])
        on_y = on_y + ratio(right_y, octave.pivots[1])
        return interleave(corners, on_x, on_y, middles, shape)

    return no_fuse(sides)
