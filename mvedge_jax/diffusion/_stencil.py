"""The five-point stencil: products with the matrix, its diagonal, and sums over the image.

Every function works on the last two axes, so that a leading axis is a batch. Shifts are written
as padded slices, which XLA compiles to one vectorized pass over the image on the CPU.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Coefficients(NamedTuple):
    """The matrix `diag(weight) + L_t`, with any leading batch axes.

    Attributes:
        weight: data weights, at least 0, `[..., y, x]`.
        tx: edges to the right, at least 0, `[..., y, x - 1]`.
        ty: edges downwards, at least 0, `[..., y - 1, x]`.
    """

    weight: Array
    tx: Array
    ty: Array


def pad(values: Array, y: tuple[int, int], x: tuple[int, int]) -> Array:
    """Pads the last two axes with zeros."""
    if y == x == (0, 0):
        return values
    return jnp.pad(values, [(0, 0)] * (values.ndim - 2) + [y, x])


def around(along_x: Array, along_y: Array, sign: int) -> Array:
    """Adds to each pixel the values of its edges: right and lower ones times `sign`."""
    right, lower = pad(along_x, (0, 0), (0, 1)), pad(along_y, (0, 1), (0, 0))
    left, upper = pad(along_x, (0, 0), (1, 0)), pad(along_y, (1, 0), (0, 0))
    return left + upper + (right + lower if sign > 0 else -right - lower)


def differences(values: Array) -> tuple[Array, Array]:
    """Right minus left and lower minus upper pixel of each edge."""
    return values[..., 1:] - values[..., :-1], values[..., 1:, :] - values[..., :-1, :]


def product(coefficients: Coefficients, values: Array) -> Array:
    """`A values`, from differences along edges.

    The diagonal minus the neighbors would be equal in exact arithmetic, but in float32 it loses a
    data weight of 1 beside an edge weight of 1e7.
    """
    along_x, along_y = differences(values)
    flux = around(coefficients.tx * along_x, coefficients.ty * along_y, -1)
    return coefficients.weight * values + flux


def diagonal(coefficients: Coefficients) -> Array:
    """The diagonal of the matrix: data weight and the weights of the pixel's edges.

    Args:
        coefficients: the matrix.

    Returns:
        An image, `[..., y, x]`: the simplest preconditioner. Differentiable.
    """
    return coefficients.weight + around(coefficients.tx, coefficients.ty, 1)


def spread(number: Array) -> Array:
    """Gives one number per image two axes of length one."""
    return number[..., None, None]


def inner(a: Array, b: Array) -> Array:
    """Inner product of two images, per image of a batch."""
    return jnp.sum(a * b, axis=(-2, -1))


def largest(values: Array) -> Array:
    """Largest magnitude in an image, per image of a batch."""
    return jnp.max(jnp.abs(values), axis=(-2, -1), initial=0.0)


def reachable(coefficients: Coefficients) -> Array:
    """Pixels that are connected with some data through edges of positive weight, as a mask.

    If all edges are positive, the data weights decide. Otherwise the data flood the image, one
    pixel of path length per step.
    """
    weight, tx, ty = coefficients
    data = weight > 0
    open_x, open_y = tx > 0, ty > 0
    everywhere = jnp.any(data, axis=(-2, -1))
    closed = ~(jnp.all(open_x, axis=(-2, -1)) & jnp.all(open_y, axis=(-2, -1)))
    flooding = closed & everywhere

    def step(state: tuple[Array, Array]) -> tuple[Array, Array]:
        reached, _ = state
        grown = (
            reached
            | pad(open_x & reached[..., 1:], (0, 0), (0, 1))
            | pad(open_x & reached[..., :-1], (0, 0), (1, 0))
            | pad(open_y & reached[..., 1:, :], (0, 1), (0, 0))
            | pad(open_y & reached[..., :-1, :], (1, 0), (0, 0))
        )
        return grown, jnp.any(grown != reached)

    flooded, _ = jax.lax.while_loop(lambda state: state[1], step, (data, jnp.any(flooding)))
    return jnp.where(spread(flooding), flooded, spread(everywhere))


def energy(
    coefficients: Coefficients, label: Float[Array, "y x"], value: Float[Array, "y x"]
) -> Float[Array, ""]:
    """The quadratic form that the solution minimizes."""
    along_x, along_y = differences(value)
    data = coefficients.weight * (value - label) ** 2
    return (
        jnp.sum(data)
        + jnp.sum(coefficients.tx * along_x**2)
        + jnp.sum(coefficients.ty * along_y**2)
    )
