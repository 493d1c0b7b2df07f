"""Aggregation multigrid: one V-cycle, a fixed symmetric positive definite operator."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ._stencil import Coefficients, diagonal, double, halve, neighbours, pad

_DEGREE = 3
_LOWEST = 0.3


class Level(NamedTuple):
    """One level, scaled to a unit diagonal: `root` is the square root of the diagonal."""

    root: Array
    tx: Array
    ty: Array


class Multigrid(NamedTuple):
    """The hierarchy, finest level first. The coarsest has one pixel."""

    levels: tuple[Level, ...]


def _coarsen(coefficients: Coefficients) -> Coefficients:
    weight, tx, ty = coefficients
    y, x = weight.shape[-2:]
    crossing_x = pad(tx[..., 1::2], (0, y % 2), (0, 0))
    crossing_y = pad(ty[..., 1::2, :], (0, 0), (0, x % 2))
    return Coefficients(
        halve(weight),
        0.5 * (crossing_x[..., 0::2, :] + crossing_x[..., 1::2, :]),
        0.5 * (crossing_y[..., 0::2] + crossing_y[..., 1::2]),
    )


def _scale(coefficients: Coefficients) -> Level:
    root = jnp.sqrt(diagonal(coefficients))
    inverse = jnp.where(root > 0, 1 / jnp.where(root > 0, root, 1), 0)
    return Level(
        root,
        coefficients.tx * inverse[..., 1:] * inverse[..., :-1],
        coefficients.ty * inverse[..., 1:, :] * inverse[..., :-1, :],
    )


def build(coefficients: Coefficients) -> Multigrid:
    """Builds the hierarchy of a system."""
    levels = [_scale(coefficients)]
    while max(coefficients.weight.shape[-2:]) > 1:
        coefficients = _coarsen(coefficients)
        levels.append(_scale(coefficients))
    return Multigrid(tuple(levels))


def _factors(dtype: jnp.dtype) -> Array:
    """Steps of the Jacobi iteration whose product is a Chebyshev polynomial on [_LOWEST, 2]."""
    angles = np.pi * (np.arange(_DEGREE) + 0.5) / _DEGREE
    nodes = (2 + _LOWEST) / 2 + (2 - _LOWEST) / 2 * np.cos(angles)
    return jnp.asarray(1 / nodes, dtype)


def _smooth(value: Array, right: Array, level: Level, factors: Array) -> Array:
    # The scan keeps XLA from fusing the steps: it would compute each stencil anew for each of
    # its neighbours, 50 times slower for three steps.
    def step(value: Array, factor: Array) -> tuple[Array, None]:
        return (1 - factor) * value + factor * (right + neighbours(value, level.tx, level.ty)), None

    return lax.scan(step, value, factors)[0]


def _cycle(levels: tuple[Level, ...], residual: Array) -> Array:
    level = levels[0]
    inverse = jnp.where(level.root > 0, 1 / jnp.where(level.root > 0, level.root, 1), 0)
    right = inverse * residual
    if len(levels) == 1:
        return inverse * right
    factors = _factors(residual.dtype)
    value = _smooth(factors[0] * right, right, level, factors[1:])
    remaining = level.root * (right - value + neighbours(value, level.tx, level.ty))
    correction = _cycle(levels[1:], halve(remaining))
    value = value + level.root * double(correction, (value.shape[-2], value.shape[-1]))
    return inverse * _smooth(value, right, level, factors)


def apply(multigrid: Multigrid, residual: Array) -> Array:
    """One V-cycle on `residual`, from zero: an estimate of the error that belongs to it."""
    return _cycle(multigrid.levels, residual)
