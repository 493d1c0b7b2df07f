"""Vignettes: what a view's brightness, relative to the centre view's, changes by over the frame."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._product import FULL

from ._brightness import Brightness

# Polynomials per axis: of degree 0 to 3.
SIZE = 4
_NORMS = np.sqrt(2 * np.arange(SIZE) + 1)
_ORDERS = np.maximum.outer(np.arange(SIZE), np.arange(SIZE))
# Which products of polynomials are of order 1, 2 and 3.
_MEMBERS = np.stack([order == _ORDERS for order in range(1, SIZE)])


class _Fit(NamedTuple):
    """Coefficients of the log ratio of every view, and the variance of each of them."""

    coefficients: Float[Array, "s 4 4"]
    variance: Float[Array, " s"]


def _polynomials(size: int, block: int) -> np.ndarray:
    """Legendre polynomials of degree 0 to 3, each of mean square 1, at blocks along an axis.

    Args:
        size: pixels along that axis.
        block: pixels of a block.

    Returns:
        One value per block and degree.
    """
    places = (np.arange(size // block) + 0.5) * block
    return np.polynomial.legendre.legvander(2 * places / size - 1, SIZE - 1) * _NORMS


def falloff(
    coefficients: Float[Array, "*s 4 4"], shape: tuple[int, ...], *, block: int = 1
) -> Float[Array, "*s y x"]:
    """What the pixels of views are multiplied by to take vignettes out: 1 without any.

    Args:
        coefficients: see `Exposure.vignette`.
        shape: rows and columns; any resolution of the same frame.
        block: side of square blocks of pixels.

    Returns:
        One factor per block. Differentiable.
    """
    down, across = (jnp.asarray(_polynomials(n, block), coefficients.dtype) for n in shape)
    logs = jnp.einsum("...kl,yk,xl->...yx", coefficients, down, across, precision=FULL)
    return jnp.exp(-logs)


def falloff_at(
    coefficients: Float[Array, "s 4 4"], basis: Float[Array, "s n 16"]
) -> Float[Array, "s n"]:
    """`falloff` at places, see `basis_at`."""
    flat = coefficients.reshape(coefficients.shape[0], -1)
    return jnp.exp(-jnp.einsum("snk,sk->sn", basis, flat, precision=FULL))


def basis_of_blocks(shape: tuple[int, ...], block: int) -> np.ndarray:
    """Products of polynomials at the centers of the blocks of a frame, `[n, 16]`."""
    down, across = (_polynomials(n, block) for n in shape)
    return np.einsum("yk,xl->yxkl", down, across).reshape(-1, SIZE**2)


def basis_at(
    y: Float[Array, "*p"], x: Float[Array, "*p"], shape: tuple[int, int]
) -> Float[Array, "*p 16"]:
    """Products of polynomials at places of a view, px; those outside of the frame are moved in."""
    height, width = shape
    t = jnp.stack([(2 * y + 1) / height - 1, (2 * x + 1) / width - 1])
    t = jnp.clip(t, -1, 1)
    square = t * t
    values = [jnp.ones_like(t), t, 1.5 * square - 0.5, (2.5 * square - 1.5) * t]
    values = [norm * value for norm, value in zip(_NORMS.tolist(), values, strict=True)]
    down, across = jnp.stack(values, axis=-1)
    return (down[..., :, None] * across[..., None, :]).reshape(*y.shape, SIZE**2)


def vignettes(
    logs: Float[Array, "s n"],
    known: Float[Array, "s n"],
    basis: Float[Array, "s n 16"],
    params: Brightness,
    *,
    least: Float[Array, ""],
) -> Float[Array, "s 4 4"]:
    """Robust fit of smooth log ratios, kept where they are no accident.

    Args:
        logs: of the ratio of every view to the centre view, place by place.
        known: 1 where both show the scene, 0 elsewhere.
        basis: see `basis_at`.
        params: see `Brightness`.
        least: standard deviation of the log ratios over all views and the frame that scenes
            without vignettes have.

    Returns:
        Coefficients, without the constant, which is the gain; exactly 0 where the ratios of all
        views together are no more than a scene without vignettes has. Differentiable.
    """
    return _earned(_fitted(logs, known, basis, params), least)


def _fitted(logs: Array, known: Array, basis: Array, params: Brightness) -> _Fit:
    """Weighted least squares, reweighted while the scale of what is an outlier falls.

    Steps of gradient descent suffice, as the polynomials are orthonormal; they leave unknown parts
    of the frame at what the known parts need least.
    """
    count = logs.shape[1]

    def weighted(flat: Array, scale: Array) -> tuple[Array, Array]:
        residual = logs - jnp.einsum("snk,sk->sn", basis, flat, precision=FULL)
        return residual, known / (1 + (residual / scale) ** 2) ** 2

    def closer(flat: Array, scale: Array) -> tuple[Array, None]:
        residual, weight = weighted(flat, scale)
        step = jnp.einsum("sn,snk->sk", weight * residual, basis, precision=FULL)
        return flat + step / count, None

    ladder = np.linspace(0, 1, params.vignette_steps)
    scales = params.vignette_outlier ** jnp.asarray(ladder, logs.dtype)
    start = jnp.zeros((logs.shape[0], SIZE**2), logs.dtype)
    flat, _ = lax.scan(closer, start, scales)
    residual, weight = weighted(flat, scales[-1])
    total = jnp.sum(weight, axis=1)
    scatter = jnp.sum(weight * residual**2, axis=1) / jnp.where(total > 0, total, 1)
    variance = scatter / jnp.maximum(total, 1)
    return _Fit(flat.reshape(-1, SIZE, SIZE), variance)


def _earned(fit: _Fit, least: Float[Array, ""]) -> Float[Array, "s 4 4"]:
    """Every order shrunk by its share of chance, and all of them where they hardly matter."""
    dtype = fit.coefficients.dtype
    power = jnp.mean(fit.coefficients**2, axis=0)
    own = jnp.einsum("okl,kl->o", jnp.asarray(_MEMBERS, dtype), power, precision=FULL)
    chance = 2 * jnp.asarray(_MEMBERS.sum((1, 2)), dtype) * jnp.mean(fit.variance)
    over = jnp.maximum(own - chance, 0)
    share = over / jnp.where(own > 0, own, 1)
    # Off up to `least`, on from the square root of 2 times that.
    switch = jnp.clip(jnp.sum(over) / least**2 - 1, 0, 1)
    kept = jnp.einsum("okl,o->kl", jnp.asarray(_MEMBERS, dtype), switch * share, precision=FULL)
    return kept[None] * fit.coefficients
