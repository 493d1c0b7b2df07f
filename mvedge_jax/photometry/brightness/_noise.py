"""The noise of a scene, measured once."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import accepts_numpy, cast
from mvedge_jax.image import window_sum
from mvedge_jax.lightfield import LightField

from ._brightness import Brightness, NoiseModel
from ._exposure import Exposure
from ._uncalibrated import GridViews

# Rounding of 8-bit views, the usual format.
_STEP = 1.0 / 255


class Noise(NamedTuple):
    """The noise of a scene's views.

    Attributes:
        deviation: standard deviation of a color channel, quantization included, in units of the
            views as they are compared (after exposure and gains): sRGB in [0, 1] or a multiple.
        alpha: dominance of the noise, 0..1: 0 up to the rounding of 8 bits, one half at a standard
            deviation of about 1.5 of 255.
        rounding: standard deviation of the rounding error of the stored views, in units of sRGB:
            .29 of 255 in views of 8 bits.
    """

    deviation: Float[Array, ""]
    alpha: Float[Array, ""]
    rounding: Float[Array, ""]

    @staticmethod
    def of(deviation: Float[Array, ""], rounding: Float[Array, ""] | None = None) -> "Noise":
        """The noise of a known standard deviation.

        Args:
            deviation: standard deviation in units of the views.
            rounding: see `Noise`; None for 8 bits.

        Returns:
            Noise whose `alpha` follows from it. Differentiable.

        Example:
            >>> import jax.numpy as jnp
            >>> [round(float(Noise.of(jnp.asarray(s)).alpha), 2) for s in (0.003, 0.01, 0.05)]
            [0.0, 0.83, 0.99]
        """
        excess = jnp.maximum(deviation**2 - (1.2 * _STEP) ** 2, 0)
        if rounding is None:
            rounding = jnp.asarray(_STEP * 12**-0.5, deviation.dtype)
        return Noise(deviation, excess / (excess + 0.004**2), rounding)


class Known(NamedTuple):
    """Brightness and noise that were measured before: of a whole image, or of an earlier frame.

    Attributes:
        exposure: of every view.
        noise: of the views, exposure taken out.
    """

    exposure: Exposure
    noise: Noise


@lean_jit
def rough_brightness(
    light_field: LightField, *, params: Brightness | None = None
) -> tuple[Exposure, Noise]:
    """Exposure, gains and noise without known disparities.

    Args:
        light_field: the crosshair of views is read.
        params: see `Brightness`; None for the defaults.

    Returns:
        `GridViews.rough_exposure`, and the noise of the center view alone. Differentiable.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> views = 0.5 + 0.02 * jax.random.normal(jax.random.key(0), (3, 3, 64, 64, 3))
        >>> exposure, noise = rough_brightness(LightField(views))
        >>> float(exposure.scale), 0.017 < float(noise.deviation) < 0.023
        (1.0, True)
    """
    params = Brightness() if params is None else params
    exposure = GridViews(light_field).rough_exposure(params)
    center = jnp.moveaxis(light_field.center_view, -1, 0)
    noise = measure_noise(exposure.scale * center, exposure.scale, params=params.noise)
    return exposure, noise


@accepts_numpy
def measure_noise(
    center: Float[Array, "c y x"],
    exposure: Float[Array, ""],
    *,
    between: Float[Array, ""] | None = None,
    params: NoiseModel | None = None,
) -> Noise:
    """Measures the noise of a scene.

    The result is the lower of two estimates: second differences in the smoothest regions of the
    center view, too large if texture is everywhere, and the residual of the best disparity between
    views, too large on gloss. Neither may lie below the rounding error of the views: that of 8 or
    10 bits if all colors lie on such steps, else that of `NoiseModel.finest`.

    Args:
        center: the center view, `[c, y, x]`, multiplied by `exposure`.
        exposure: see `Exposure.scale`.
        between: the second estimate, see `between_views_variance`; None leaves it out.
        params: see `NoiseModel`; None for the defaults.

    Returns:
        The noise. Differentiable. The detection of steps is a selection; views of 8 bits that are
        changed a little have none.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> noisy = 0.5 + 0.02 * jax.random.normal(jax.random.key(0), (3, 64, 64))
        >>> 0.017 < float(measure_noise(noisy, jnp.asarray(1.0)).deviation) < 0.023
        True
    """
    params = cast(NoiseModel() if params is None else params, center.dtype)
    variance = params.single**2 * single_view_variance(center, exposure)
    if between is not None:
        variance = jnp.minimum(variance, params.between**2 * between)
    rounding = _rounding(center / exposure, params.finest)
    return Noise.of(jnp.sqrt(jnp.maximum(variance, (exposure * rounding) ** 2)), rounding)


def _rounding(image: Array, finest: Float[Array, ""]) -> Float[Array, ""]:
    """Standard deviation of the rounding error of a stored image, uniform within a step."""
    step = finest
    # Steps of 10 and of 8 bits, the coarsest last.
    for candidate in (1 / 1023, _STEP):
        levels = image / candidate
        # A quarter on average if the values are not on such steps.
        off = jnp.mean(jnp.abs(levels - jnp.round(levels)))
        step = jnp.where(off < 0.01, candidate, step)
    return step * 12**-0.5


def single_view_variance(
    image: Float[Array, "c y x"], exposure: Float[Array, ""]
) -> Float[Array, ""]:
    """The 20 % quantile of the local variance of mixed second differences, median over channels.

    The product of second differences along x and y vanishes on planes and on straight edges along
    either axis; its local mean square is the noise plus texture. Clipped pixels show no noise and
    are ignored. 0 for images below 9 px a side or with clipped pixels only.
    """
    if min(image.shape[1:]) < 9:
        return jnp.zeros((), image.dtype)
    open_ = (image > 0.5 * _STEP * exposure) & (image < (1 - 0.5 * _STEP) * exposure)
    open_ = open_.astype(image.dtype)

    def mixed(values: Array) -> Array:
        across = values[..., 2:] - 2 * values[..., 1:-1] + values[..., :-2]
        return across[:, 2:] - 2 * across[:, 1:-1] + across[:, :-2]

    def local(values: Array) -> Array:
        sums = window_sum(window_sum(values, 3, 1), 3, 2)
        return sums[:, 3:-3:3, 3:-3:3].reshape(values.shape[0], -1)

    usable = open_[..., 2:] * open_[..., 1:-1] * open_[..., :-2]
    usable = usable[:, 2:] * usable[:, 1:-1] * usable[:, :-2]
    pixels = local(usable)
    known = pixels > 24
    square = jnp.where(known, local(usable * mixed(image) ** 2) / jnp.maximum(36 * pixels, 1), 0)
    ordered = jnp.sort(jnp.where(known, square, jnp.inf), axis=1)
    count = jnp.sum(known, axis=1)
    values = jnp.take_along_axis(ordered, count[:, None] // 5, axis=1)[:, 0]
    values = jnp.where(count > 0, values, 0)
    return jnp.sort(values)[values.shape[0] // 2]
