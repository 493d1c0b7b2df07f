"""Multigrid with operator-dependent interpolation: one V-cycle, symmetric and definite."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from mvedge_jax._cpu import no_fuse

from ._coarsen import Interpolation, Stencil, coarsen, degree, fill, interpolate, restrict, ties
from ._stencil import Coefficients

# Steps of a smoother, and the least eigenvalue (of at most 2) that they damp. They affect the
# number of iterations, not the solution.
_DEGREE = 3
_LOWEST = 0.3
# Levels up to this many pixels a side are padded to one shape and run in a loop: their time is
# negligible, but every unrolled level costs compile time.
_SMALL = 32


class Level(NamedTuple):
    """One level, scaled so that its eigenvalues lie between 0 and 2.

    Attributes:
        root: square roots of the scale factors.
        stencil: the scaled edges; the mass is that of the unscaled matrix. The diagonal is 1.
        weights: interpolation from the next level, unscaled.
    """

    root: Array
    stencil: Stencil
    weights: Interpolation


class Hierarchy(NamedTuple):
    """All levels.

    Attributes:
        fine: the large levels, finest first.
        small: the other ones, padded to one shape and stacked on the axis before the image, so
            that a batch axis stays the first. The last has one pixel.
    """

    fine: tuple[Level, ...]
    small: Level


def build(coefficients: Coefficients) -> Hierarchy:
    """Builds the hierarchy of a system."""
    stencil = Stencil(*coefficients, None, None)
    fine = []
    while max(stencil.mass.shape[-2:]) > _SMALL:
        coarse, weights = coarsen(stencil)
        fine.append(no_fuse(_scale, stencil, weights))
        stencil = coarse
    y, x = stencil.mass.shape[-2:]
    if stencil.falling is None:
        diagonals = jnp.zeros((*stencil.mass.shape[:-2], y - 1, x - 1), stencil.mass.dtype)
        stencil = Stencil(*coefficients, diagonals, diagonals)

    def step(stencil: Stencil, _: None) -> tuple[Stencil, Level]:
        coarse, weights = coarsen(stencil)
        edges = (coarse.tx, coarse.ty, coarse.falling, coarse.rising)
        shapes = ((y, x - 1), (y - 1, x), (y - 1, x - 1), (y - 1, x - 1))
        filled = [
            fill(maps, shape) for maps, shape in zip(edges, shapes, strict=True) if maps is not None
        ]
        return Stencil(fill(coarse.mass, (y, x)), *filled), _scale(stencil, weights)

    count = (max(y, x) - 1).bit_length() + 1
    _, small = lax.scan(step, stencil, None, length=count)
    return Hierarchy(tuple(fine), jax.tree.map(lambda maps: jnp.moveaxis(maps, 0, -3), small))


def cycle(hierarchy: Hierarchy) -> Callable[[Array], Array]:
    """The V-cycle as a function from a residual to an estimate of the error behind it."""
    small = jax.tree.map(lambda maps: jnp.moveaxis(maps, -3, 0), hierarchy.small)
    return lambda residual: _cycle(hierarchy.fine, small, residual)


def _cycle(fine: tuple[Level, ...], small: Level, residual: Array) -> Array:
    if not fine:
        return _small_cycle(small, residual)
    level, *rest = fine
    value, right, coarse = _down(level, residual)
    return _up(level, value, right, _cycle(tuple(rest), small, coarse))


def _small_cycle(levels: Level, residual: Array) -> Array:
    shape = (residual.shape[-2], residual.shape[-1])

    def down(residual: Array, level: Level) -> tuple[Array, tuple[Array, Array]]:
        value, right, coarse = _down(level, residual)
        return fill(coarse, shape), (value, right)

    def up(correction: Array, visited: tuple[Level, Array, Array]) -> tuple[Array, None]:
        return _up(*visited, correction), None

    upper = jax.tree.map(lambda maps: maps[:-1], levels)
    bottom, (values, rights) = lax.scan(down, residual, upper)
    # One pixel remains, with the sum of all data weights.
    solution = _inverse(levels.root[-1]) ** 2 * bottom
    return lax.scan(up, solution, (upper, values, rights), reverse=True)[0]


def _down(level: Level, residual: Array) -> tuple[Array, Array, Array]:
    """Smooths from zero and restricts what remains."""
    factors = _factors(residual.dtype)
    right = _inverse(level.root) * residual
    value = _smooth(factors[0] * right, right, level, factors[1:])
    remaining = no_fuse(lambda: level.root * _residual(value, right, level))
    return value, right, restrict(level.weights, remaining)


def _up(level: Level, value: Array, right: Array, correction: Array) -> Array:
    """Adds the correction of the next level and smooths."""
    shape = (value.shape[-2], value.shape[-1])
    correction = correction[..., : (shape[0] + 1) // 2, : (shape[1] + 1) // 2]
    value = value + level.root * interpolate(level.weights, correction, shape)
    return _inverse(level.root) * _smooth(value, right, level, _factors(value.dtype))


def _smooth(value: Array, right: Array, level: Level, factors: Array) -> Array:
    # The scan keeps XLA from fusing the steps: it would recompute each stencil for each of its
    # neighbors, 50 times slower for three steps.
    def step(value: Array, factor: Array) -> tuple[Array, None]:
        return value + factor * _residual(value, right, level), None

    return lax.scan(step, value, factors)[0]


def _residual(value: Array, right: Array, level: Level) -> Array:
    return right - value + ties(level.stencil, value)


def _factors(dtype: jnp.dtype) -> Array:
    """Steps of the Jacobi iteration whose product is a Chebyshev polynomial on [_LOWEST, 2]."""
    angles = np.pi * (np.arange(_DEGREE) + 0.5) / _DEGREE
    nodes = (2 + _LOWEST) / 2 + (2 - _LOWEST) / 2 * np.cos(angles)
    return jnp.asarray(1 / nodes, dtype)


def _scale(stencil: Stencil, weights: Interpolation) -> Level:
    root = jnp.sqrt(degree(stencil))
    inverse = _inverse(root)
    diagonals: list[Array | None] = [None, None]
    if stencil.falling is not None and stencil.rising is not None:
        diagonals = [
            stencil.falling * inverse[..., 1:, 1:] * inverse[..., :-1, :-1],
            stencil.rising * inverse[..., 1:, :-1] * inverse[..., :-1, 1:],
        ]
    scaled = Stencil(
        stencil.mass,
        stencil.tx * inverse[..., 1:] * inverse[..., :-1],
        stencil.ty * inverse[..., 1:, :] * inverse[..., :-1, :],
        *diagonals,
    )
    return Level(root, scaled, weights)


def _inverse(root: Array) -> Array:
    return jnp.where(root > 0, 1 / jnp.where(root > 0, root, 1), 0)
