"""Denoising of the guide and low-pass of noisy views."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import cast
from mvedge_jax.image import box_mean, gaussian, gaussian_taps

from ._brightness import NoiseModel
from ._noise import Noise


def denoised(
    image: Float[Array, "c y x"], noise: Noise, *, params: NoiseModel | None = None
) -> Float[Array, "c y x"]:
    """Denoises the center view with its edges kept, as a guide.

    An adaptive Wiener filter over 7x7 px: a pixel becomes the local mean if the local variance is
    that of the noise, and keeps its value if the variance is much larger.

    Args:
        image: `[c, y, x]`.
        noise: noise of the image.
        params: only `excess` is read; None for the defaults.

    Returns:
        The filtered image, `[c, y, x]`; the image itself where `noise.alpha` is 0. Differentiable.

    Source: not in the thesis; Lee (1980), "Digital image enhancement and noise filtering by use
        of local statistics", with averaged coefficients.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> noisy = 0.5 + 0.05 * jax.random.normal(jax.random.key(0), (3, 32, 32))
        >>> float(denoised(noisy, Noise.of(jnp.asarray(0.05))).std()) < 0.02
        True
    """
    params = cast(NoiseModel() if params is None else params, image.dtype)

    def filtered(image: Array) -> Array:
        mean = box_mean(image, 3)
        spread = jnp.maximum(box_mean(image * image, 3) - mean * mean, 0)
        variance = sum((spread[c] for c in range(1, spread.shape[0])), spread[0]) / len(spread)
        own = jnp.maximum(variance - params.excess * noise.deviation**2, 0)
        keep = own / jnp.where(variance > 0, variance, 1)
        smooth = box_mean(keep, 3)[None] * image + box_mean((1 - keep)[None] * mean, 3)
        return image + noise.alpha * (smooth - image)

    return lax.cond(noise.alpha > 0, jax.checkpoint(filtered), lambda image: image, image)


def soften(
    images: Float[Array, "s c y x"], noise: Noise, sigma: Float[Array, ""]
) -> Float[Array, "s c y x"]:
    """Blurs images according to the dominance of noise.

    Interpolation between pixels averages noise, shifts by whole pixels do not, so costs would
    prefer shifts by half a pixel; after a blur, both have nearly the same noise. The width `sigma`
    is at most about 1 px. Differentiable; the images themselves if `noise.alpha` is 0.
    """

    def blurred(images: Array) -> Array:
        return images + noise.alpha * (gaussian(images, sigma, 3) - images)

    return lax.cond(noise.alpha > 0, jax.checkpoint(blurred), lambda images: images, images)


def low_pass(noise: Noise) -> Callable[[Float[Array, "s c y x"]], Float[Array, "s c y x"]]:
    """The blur of views before the measurement: `soften` with the width for this noise.

    Args:
        noise: noise of the views.

    Returns:
        The function of the images. Differentiable.
    """
    return lambda planes: soften(planes, noise, blur_of(noise))


def blur_of(noise: Noise) -> Float[Array, ""]:
    """Standard deviation of `low_pass`, px."""
    return jnp.minimum(30 * noise.deviation, 1)


def passed(noise: Noise, sigma: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Shares of white noise that remain after `soften`, 0..1. Differentiable.

    Returns:
        Remaining share of its variance, and remaining share of the energy of its derivative per
        variance.
    """
    alpha, taps = noise.alpha, gaussian_taps(sigma, 3)
    middle, energy = taps[3] ** 2, jnp.sum(taps**2) ** 2
    kept = (1 - alpha) ** 2 + 2 * alpha * (1 - alpha) * middle + alpha**2 * energy
    white = _derivative_energy(taps, jnp.zeros_like(alpha))
    return kept, _derivative_energy(taps, alpha) / white


def _derivative_energy(taps: Float[Array, " k"], alpha: Float[Array, ""]) -> Float[Array, ""]:
    """Energy of the spline derivative along x of blurred white noise over its variance, 1/px².

    By Parseval: an integral over frequencies of the spectrum of cubic splines. Products of splines
    over all positions between pixels are B-splines of degree 7, those of slopes second differences
    of B-splines of degree 5.
    """
    angles = jnp.asarray(2 * np.pi * np.arange(32) / 32, taps.dtype)
    radius = taps.shape[0] // 2
    gain = jnp.full_like(angles, taps[radius])
    for k in range(1, radius + 1):
        gain = gain + 2 * taps[radius + k] * jnp.cos(k * angles)
    passed = jnp.mean((1 - alpha + alpha * gain[:, None] * gain[None]) ** 2, axis=0)

    def spectrum(samples: tuple[float, ...]) -> Array:
        terms = (2 * a * jnp.cos(k * angles) for k, a in enumerate(samples[1:], start=1))
        return sum(terms, jnp.full_like(angles, samples[0]))

    splines = spectrum((4 / 6, 1 / 6)) ** 2
    value = spectrum((2416 / 5040, 1191 / 5040, 120 / 5040, 1 / 5040)) / splines
    slope = spectrum((80 / 120, -15 / 120, -24 / 120, -1 / 120)) / splines
    return jnp.sum(passed * slope) / jnp.sum(passed * value)
