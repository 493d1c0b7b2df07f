"""What the photometry shares: Gaussian, box, largest value around a pixel, interpolation."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float


def window_sum(image: Array, radius: int, axis: int) -> Array:
    """Sum over `2 radius + 1` neighbours along an axis, borders repeated."""
    margin = [(0, 0)] * image.ndim
    margin[axis] = (radius, radius)
    padded = jnp.pad(image, margin, mode="edge")
    size = image.shape[axis]
    # By hand: XLA on CPU vectorises sums of slices, but no window reduction.
    return sum(
        (lax.slice_in_dim(padded, i, i + size, axis=axis) for i in range(1, 2 * radius + 1)),
        lax.slice_in_dim(padded, 0, size, axis=axis),
    )


def box_mean(image: Float[Array, "*c y x"], radius: int) -> Float[Array, "*c y x"]:
    """Mean over a square of `2 radius + 1` px a side, borders repeated.

    Args:
        image: one image or several, `[..., y, x]`.
        radius: px to either side.

    Returns:
        The means, of the shape of `image`. Differentiable.
    """
    area = (2 * radius + 1) ** 2
    return window_sum(window_sum(image, radius, -2 % image.ndim), radius, image.ndim - 1) / area


def gaussian_taps(sigma: Float[Array, ""], radius: int) -> Float[Array, " k"]:
    """Taps of a Gaussian, which sum to 1; `sigma` 0 gives the identity."""
    offsets = jnp.arange(-radius, radius + 1, dtype=sigma.dtype)
    # Where a Gaussian is much narrower than a pixel its neighbours get nothing anyway.
    safe = jnp.maximum(sigma, 0.1)
    taps = jnp.exp(-0.5 * (offsets / safe) ** 2)
    return taps / jnp.sum(taps)


def convolved(image: Array, taps: Float[Array, " k"], axis: int) -> Array:
    """Image filtered along an axis with an odd number of taps, borders repeated."""
    radius = taps.shape[0] // 2
    axis = axis % image.ndim
    margin = [(0, 0)] * image.ndim
    margin[axis] = (radius, radius)
    padded = jnp.pad(image, margin, mode="edge")
    size = image.shape[axis]
    parts = [
        taps[i] * lax.slice_in_dim(padded, i, i + size, axis=axis) for i in range(taps.shape[0])
    ]
    return sum(parts[1:], parts[0])


def gaussian(
    image: Float[Array, "*c y x"], sigma: Float[Array, ""], radius: int
) -> Float[Array, "*c y x"]:
    """Image blurred by a Gaussian, borders repeated.

    Args:
        image: one image or several, `[..., y, x]`.
        sigma: standard deviation, px; 0 gives the identity.
        radius: where the Gaussian is cut, px.

    Returns:
        The blurred image, of the shape of `image`. Differentiable in both, in `sigma` from .1 px.
    """
    taps = gaussian_taps(sigma, radius)
    return convolved(convolved(image, taps, -2), taps, -1)


def highest(image: Float[Array, "y x"], radius: int) -> Float[Array, "y x"]:
    """Largest value within a square of `2 radius + 1` px a side.

    Args:
        image: `[y, x]`.
        radius: px to either side.

    Returns:
        The maxima, `[y, x]`. Differentiable, at the place chosen.
    """
    for axis in (0, 1):
        reach = 0
        while reach < radius:
            step = min(reach + 1, radius - reach) if reach else 1
            margin = [(0, 0), (0, 0)]
            margin[axis] = (step, step)
            padded = jnp.pad(image, margin, mode="edge")
            size = image.shape[axis]
            below = lax.slice_in_dim(padded, 0, size, axis=axis)
            above = lax.slice_in_dim(padded, 2 * step, 2 * step + size, axis=axis)
            image = jnp.maximum(image, jnp.maximum(below, above))
            reach += step
    return image


def keys_taps(fraction: Array) -> tuple[Array, Array, Array, Array]:
    """Taps of Keys' cubic interpolation at a fraction of a pixel."""
    f = fraction
    return (
        -0.5 * f * (1 - f) ** 2,
        1 + 0.5 * f * f * (3 * f - 5),
        0.5 * f * (1 + f * (4 - 3 * f)),
        0.5 * f * f * (f - 1),
    )
