"""Vignettes: variation over the frame of a view's brightness relative to the center view's."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._product import FULL
from mvedge_jax._root import LEAST_DIVISOR

from ._brightness import Brightness

# Polynomials per axis: of degree 0 to 3.
SIZE = 4
_NORMS = np.sqrt(2 * np.arange(SIZE) + 1)
_ORDERS = np.maximum.outer(np.arange(SIZE), np.arange(SIZE))
# Which products of polynomials are of order 1, 2 and 3.
_MEMBERS = np.stack([order == _ORDERS for order in range(1, SIZE)])


class _Fit(NamedTuple):
    """A fit of log ratios; `common` is the factor of `radial` that all views share."""

    coefficients: Float[Array, "s 4 4"]
    variance: Float[Array, " s"]
    common: Float[Array, ""]
    common_variance: Float[Array, ""]


def _polynomials(size: int, block: int) -> np.ndarray:
    """Legendre polynomials of degree 0 to 3, of mean square 1, at blocks along an axis."""
    places = (np.arange(size // block) + 0.5) * block
    return np.polynomial.legendre.legvander(2 * places / size - 1, SIZE - 1) * _NORMS


def falloff(
    coefficients: Float[Array, "*s 4 4"], shape: tuple[int, ...], *, block: int = 1
) -> Float[Array, "*s y x"]:
    """Factors that remove vignettes, per pixel or per square block of pixels. Differentiable.

    Args:
        coefficients: see `Exposure.vignette`.
        shape: rows and columns; any resolution of the same frame.
        block: side of the blocks, px.
    """
    down, across = (jnp.asarray(_polynomials(n, block), coefficients.dtype) for n in shape)
    logs = jnp.einsum("...kl,yk,xl->...yx", coefficients, down, across, precision=FULL)
    return jnp.exp(-logs)


def cropped(
    coefficients: Float[Array, "*s 4 4"],
    start: tuple[int, int],
    size: tuple[int, int],
    whole: tuple[int, int],
) -> Float[Array, "*s 4 4"]:
    """Coefficients of the same vignettes over a part of the frame. Differentiable.

    Exact, because the polynomials over the part are of the same degrees. `start` is the first row
    and column of the part, `size` and `whole` are rows and columns of the part and of the frame.
    """
    down, across = (
        jnp.asarray(_change(*along), coefficients.dtype)
        for along in zip(start, size, whole, strict=True)
    )
    return jnp.einsum("ik,...kl,jl->...ij", down, coefficients, across, precision=FULL)


def _change(start: int, size: int, whole: int) -> np.ndarray:
    """From coefficients over an axis to those over a part of it."""
    places, weights = np.polynomial.legendre.leggauss(SIZE)
    there = (2 * start + size * (places + 1)) / whole - 1
    own, outer = (np.polynomial.legendre.legvander(x, SIZE - 1) * _NORMS for x in (places, there))
    return 0.5 * np.einsum("n,nk,nl->kl", weights, own, outer)


def falloff_at(
    coefficients: Float[Array, "s 4 4"], basis: Float[Array, "s n 16"]
) -> Float[Array, "s n"]:
    """`falloff` at positions, see `basis_at`."""
    flat = coefficients.reshape(coefficients.shape[0], -1)
    return jnp.exp(-jnp.einsum("snk,sk->sn", basis, flat, precision=FULL))


def basis_of_blocks(shape: tuple[int, ...], block: int) -> np.ndarray:
    """Products of polynomials at the centers of the blocks of a frame, `[n, 16]`."""
    down, across = (_polynomials(n, block) for n in shape)
    return np.einsum("yk,xl->yxkl", down, across).reshape(-1, SIZE**2)


def basis_at(
    y: Float[Array, "*p"], x: Float[Array, "*p"], shape: tuple[int, int]
) -> Float[Array, "*p 16"]:
    """Products of polynomials at positions of a view, px, clipped to the frame."""
    height, width = shape
    t = jnp.stack([(2 * y + 1) / height - 1, (2 * x + 1) / width - 1])
    t = jnp.clip(t, -1, 1)
    square = t * t
    values = [jnp.ones_like(t), t, 1.5 * square - 0.5, (2.5 * square - 1.5) * t]
    values = [norm * value for norm, value in zip(_NORMS.tolist(), values, strict=True)]
    down, across = jnp.stack(values, axis=-1)
    return (down[..., :, None] * across[..., None, :]).reshape(*y.shape, SIZE**2)


def radial(shape: tuple[int, ...]) -> np.ndarray:
    """Coefficients of the square of the distance from the center of the frame, 1 in its corners."""
    down, across = (n**2 / sum(m**2 for m in shape) for n in shape)
    coefficients = np.zeros((SIZE, SIZE))
    coefficients[0, 0] = 1 / 3
    coefficients[2, 0], coefficients[0, 2] = (2 * axis / (3 * 5**0.5) for axis in (down, across))
    return coefficients


def vignettes(
    logs: Float[Array, "s n"],
    known: Float[Array, "s n"],
    basis: Float[Array, "s n 16"],
    params: Brightness,
    *,
    least: Float[Array, ""],
    shape: tuple[int, ...],
    moved: Float[Array, "s n"] | None = None,
) -> Float[Array, "s 4 4"]:
    """Robust fit of smooth log ratios, shrunk by their share of chance. Differentiable.

    Args:
        logs: log ratio of every view to the center view at every position.
        known: 1 where both show the scene, 0 elsewhere.
        basis: see `basis_at`.
        params: see `Brightness`.
        least: standard deviation of the log ratios over all views and the frame that scenes without
            vignettes have.
        shape: rows and columns of the views.
        moved: difference of `radial` between the positions in the view and in the center view, by
            parallax; None if no disparity is known.

    Returns:
        Coefficients without the constant, which is the gain. Exactly 0 if the ratios of all views
        together vary no more than those of a scene without vignettes.
    """
    moved = jnp.zeros_like(logs) if moved is None else moved
    fit = _fitted(logs, known, basis, moved, params)
    # Twice its standard error.
    chance = 4 * params.alike * fit.common_variance
    strength = fit.common**2
    share = jnp.maximum(strength - chance, 0) / jnp.maximum(strength, LEAST_DIVISOR)
    spread = float(np.sum(radial(shape).ravel()[1:] ** 2))
    switch = jnp.clip(spread * strength / params.vignette_common**2 - 1, 0, 1)
    common = switch * share * fit.common * jnp.asarray(radial(shape), logs.dtype)
    return _earned(fit, least) + common[None]


def _fitted(logs: Array, known: Array, basis: Array, moved: Array, params: Brightness) -> _Fit:
    """Iteratively reweighted least squares with a decreasing scale of outliers.

    Gradient descent suffices, as the polynomials are orthonormal; it extrapolates to unknown parts
    of the frame with small coefficients. The polynomials are also regressed out of `moved`; the
    residuals of both give the part common to all views.
    """
    count = logs.shape[1]
    both = jnp.stack([logs, moved])
    # If the polynomials explain all but a hundredth of `moved`, the residual is rounding.
    ridge = 0.01 * jnp.sum(known * moved**2) + 1e-9

    def weighted(flat: Array, common: Array, scale: Array) -> tuple[Array, Array]:
        rest = both - jnp.einsum("snk,tsk->tsn", basis, flat, precision=FULL)
        residual = rest[0] - common * rest[1]
        return rest, known / (1 + (residual / scale) ** 2) ** 2

    def closer(state: tuple[Array, Array], scale: Array) -> tuple[tuple[Array, Array], None]:
        flat, common = state
        rest, weight = weighted(flat, common, scale)
        step = jnp.einsum("tsn,snk->tsk", weight[None] * rest, basis, precision=FULL)
        power = jnp.sum(weight * rest[1] ** 2)
        common = jnp.sum(weight * rest[0] * rest[1]) / (power + ridge)
        return (flat + step / count, common), None

    ladder = np.linspace(0, 1, params.vignette_steps)
    scales = params.vignette_outlier ** jnp.asarray(ladder, logs.dtype)
    start = jnp.zeros((2, logs.shape[0], SIZE**2), logs.dtype), jnp.zeros((), logs.dtype)
    (flat, common), _ = lax.scan(closer, start, scales)
    rest, weight = weighted(flat, common, scales[-1])
    squares = weight * (rest[0] - common * rest[1]) ** 2
    total, scatter = jnp.sum(weight, axis=1), jnp.sum(squares, axis=1)
    of_all = jnp.sum(scatter) / jnp.maximum(jnp.sum(total), 1)
    return _Fit(
        (flat[0] - common * flat[1]).reshape(-1, SIZE, SIZE),
        scatter / jnp.maximum(total, 1) ** 2,
        common,
        of_all / (jnp.sum(weight * rest[1] ** 2) + 0.1 * ridge),
    )


def _earned(fit: _Fit, least: Float[Array, ""]) -> Float[Array, "s 4 4"]:
    """Shrinks every order by its share of chance, and all of them where they are small."""
    dtype = fit.coefficients.dtype
    power = jnp.mean(fit.coefficients**2, axis=0)
    own = jnp.einsum("okl,kl->o", jnp.asarray(_MEMBERS, dtype), power, precision=FULL)
    chance = 2 * jnp.asarray(_MEMBERS.sum((1, 2)), dtype) * jnp.mean(fit.variance)
    over = jnp.maximum(own - chance, 0)
    share = over / jnp.maximum(own, LEAST_DIVISOR)
    # Off up to `least`, on from the square root of 2 times that.
    switch = jnp.clip(jnp.sum(over) / least**2 - 1, 0, 1)
    kept = jnp.einsum("okl,o->kl", jnp.asarray(_MEMBERS, dtype), switch * share, precision=FULL)
    return kept[None] * fit.coefficients
