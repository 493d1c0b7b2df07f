"""Exact elimination for thin images, such as epipolar-plane images, many at once.

Pixels are numbered across the short side first, so that each is tied to at most that many later
ones. Multigrid coarsens the short side of such an image away after a few levels and needs two to
five times the iterations that it needs on a square; elimination costs as much as about two of them
(512 images of 9x512: 0.13 s of 0.22 s, where multigrid took 0.9 s), at any contrast.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ._stencil import Coefficients, pad


def factor(coefficients: Coefficients) -> tuple[Array, Array]:
    """Eliminates pixel after pixel; every later pixel takes its share of the mass and the ties.

    Keeping the row sums in place of the diagonal leaves nothing to subtract, so that no digit is
    lost at any contrast (Grassmann, Taksar & Heyman 1985).

    Args:
        coefficients: the matrix, with any leading batch axes.

    Returns:
        What each pixel's `h` successors add to it, `[n, h, b]`, and the inverse pivots, `[n, b]`,
        zero where there is nothing to solve; `h` is the short side, `n` the number of pixels,
        and `b` the size of the batch.
    """
    weight, tx, ty = coefficients
    y, x = weight.shape[-2:]
    tx, ty = pad(tx, (0, 0), (0, 1)), pad(ty, (0, 1), (0, 0))
    along, across = (tx, ty) if y <= x else (ty, tx)
    h = min(y, x)
    first, last = (jnp.asarray(np.eye(h)[:, k, None], weight.dtype) for k in (0, h - 1))

    def eliminate(
        state: tuple[Array, Array], pixel: tuple[Array, Array, Array]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        ties, mass = state
        weight, along, across = pixel
        row = jnp.pad(ties[0, 1:], ((0, 1), (0, 0))) + first * across[None] + last * along[None]
        own = mass[0] + weight
        pivot = own + jnp.sum(row, axis=0)
        safe = jnp.where(pivot != 0, pivot, 1)
        # Dividing, not multiplying by the inverse: XLA never computes a division twice, whereas
        # it would compute this product anew for each of its h readers.
        share = row / safe[None]
        ties = jnp.pad(ties[1:, 1:], ((0, 1), (0, 1), (0, 0))) + share[:, None] * row[None]
        mass = jnp.pad(mass[1:], ((0, 1), (0, 0))) + share * own[None]
        return (ties, mass), (share, jnp.where(pivot != 0, 1 / safe, 0))

    pixels = (_in_order(weight), _in_order(along), _in_order(across))
    batch = pixels[0].shape[1]
    nothing = (jnp.zeros((h, h, batch), weight.dtype), jnp.zeros((h, batch), weight.dtype))
    return lax.scan(eliminate, nothing, pixels)[1]


def substitute(factors: tuple[Array, Array], residual: Array) -> Array:
    """Solves with what `factor` returned."""
    shares, inverse = factors
    h = shares.shape[1]
    front = jnp.asarray(np.eye(h)[:, :1], residual.dtype)

    def forward(later: Array, pixel: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        share, inverse, right = pixel
        own = later[0] + right
        return jnp.pad(later[1:], ((0, 1), (0, 0))) + share * own[None], own * inverse

    def backward(later: Array, pixel: tuple[Array, Array]) -> tuple[Array, Array]:
        share, right = pixel
        own = right + jnp.sum(share * later, axis=0)
        return jnp.pad(later[:-1], ((1, 0), (0, 0))) + front * own[None], own

    nothing = jnp.zeros(shares.shape[1:], residual.dtype)
    right = lax.scan(forward, nothing, (shares, inverse, _in_order(residual)))[1]
    solution = lax.scan(backward, nothing, (shares, right), reverse=True)[1]
    return _as_images(solution, residual.shape)


def solver(coefficients: Coefficients) -> Callable[[Array], Array]:
    """The exact solution as a function of the right-hand side."""
    factors = factor(coefficients)
    return lambda residual: substitute(factors, residual)


def _in_order(images: Array) -> Array:
    """From images to pixels in the order of elimination, batch last."""
    y, x = images.shape[-2:]
    flat = images.reshape(-1, y, x)
    return jnp.transpose(flat, (2, 1, 0) if y <= x else (1, 2, 0)).reshape(y * x, -1)


def _as_images(pixels: Array, shape: tuple[int, ...]) -> Array:
    """The inverse of `_in_order`."""
    y, x = shape[-2:]
    if y <= x:
        return jnp.transpose(pixels.reshape(x, y, -1), (2, 1, 0)).reshape(shape)
    return jnp.transpose(pixels.reshape(y, x, -1), (2, 0, 1)).reshape(shape)
