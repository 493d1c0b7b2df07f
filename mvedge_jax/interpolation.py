"""Between samples: splines and their taps, a parabola's vertex, bilinear values."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy

_POLE = np.sqrt(3.0) - 2.0
# The inverse filter decays by 0.27 per sample; 1e-7 of it is left at this radius.
_RADIUS = 12
# A parabola that bends less, against its values, has its vertex where rounding puts it. Without a
# bound, the slope of a single such vertex outweighs the gradient of a whole image.
_FLAT = 1e-3


@accepts_numpy
def keys_taps(fraction: Array) -> tuple[Array, Array, Array, Array]:
    """Taps of Keys' cubic interpolation.

    Args:
        fraction: of a pixel, from the second of four samples to the position, in [0, 1].

    Returns:
        Weights of the four samples. Differentiable.

    Source: Keys (1981), "Cubic convolution interpolation for digital image processing".
    """
    f = fraction
    return (
        -0.5 * f * (1 - f) ** 2,
        1 + 0.5 * f * f * (3 * f - 5),
        0.5 * f * (1 + f * (4 - 3 * f)),
        0.5 * f * f * (f - 1),
    )


@accepts_numpy
def spline_coefficients(values: Float[Array, "*s"], *, axis: int) -> Float[Array, "*s"]:
    """Coefficients of the cubic B-spline through `values` along an axis, mirrored at the ends.

    The recursive inverse filter is written as a short symmetric one: XLA runs it as one fused
    stencil, where two recursions over the axis would be sequential.

    Args:
        values: samples, any shape.
        axis: along which to interpolate.

    Returns:
        Coefficients of the same shape. Linear, hence differentiable.
    """
    moved = jnp.moveaxis(values, axis, -1)
    size = moved.shape[-1]
    kernel = _POLE ** np.abs(np.arange(-_RADIUS, _RADIUS + 1))
    kernel = jnp.asarray(kernel / kernel.sum(), values.dtype)
    # Mirroring without repeating the border sample, for axes shorter than the filter as well.
    period = max(2 * size - 2, 1)
    index = np.abs(np.arange(-_RADIUS, size + _RADIUS)) % period
    padded = moved[..., np.minimum(index, period - index) if size > 1 else index * 0]
    total = sum(
        (kernel[i] * padded[..., i : i + size] for i in range(1, 2 * _RADIUS + 1)),
        kernel[0] * padded[..., :size],
    )
    return jnp.moveaxis(total, -1, axis)


@accepts_numpy
def cubic_taps(fraction: Float[Array, "*s"]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Weights of the four coefficients around a position, and their derivatives.

    Args:
        fraction: of a pixel, from the second of the four to the position, in [0, 1].

    Returns:
        Weights of value and of slope, four each.
    """
    f, g = fraction, 1 - fraction
    values = (
        g * g * g / 6,
        (4 + f * f * (3 * f - 6)) / 6,
        (4 + g * g * (3 * g - 6)) / 6,
        f * f * f / 6,
    )
    return values, (-0.5 * g * g, f * (1.5 * f - 2), g * (2 - 1.5 * g), 0.5 * f * f)


def spline_noise(weights: Sequence[Array]) -> Array:
    """Variance of an interpolated value per variance of white noise in the samples.

    Args:
        weights: of the four coefficients, see `cubic_taps`.

    Returns:
        1 at the samples, .76 half way between them. Differentiable.

    Example:
        >>> [round(float(spline_noise(cubic_taps(jnp.asarray(f))[0])), 3) for f in (0.0, 0.5)]
        [1.0, 0.756]
    """
    # What coefficients at a distance have in common: the inverse filter, convolved with itself.
    lag = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    alike = 3 * _POLE**lag * (lag + (1 + _POLE**2) / (1 - _POLE**2))
    taps = jnp.stack(weights)
    along = jnp.tensordot(jnp.asarray(alike, taps.dtype), taps, 1, precision="highest")
    return jnp.sum(taps * along, axis=0)


def vertex(below: Array, middle: Array, above: Array) -> Array:
    """Offset of the extremum of the parabola through three values at -1, 0 and 1.

    Args:
        below: values at -1, any shape.
        middle: at 0.
        above: at 1.

    Returns:
        Offsets in [-1, 1]; 0 where the values lie on a line, and towards that where they bend by
        less than a thousandth of what they are. Differentiable.
    """
    # In units of the values: of very small ones, squares underflow and derivatives are 0 / 0. The
    # last term is the unit where all three are 0.
    unit = jnp.abs(below) + jnp.abs(above) + jnp.finfo(middle.dtype).tiny ** 0.25 / _FLAT
    bend, slope = (below - 2 * middle + above) / unit, (below - above) / unit
    offset = 0.5 * slope * bend / jnp.maximum(bend**2, _FLAT**2)
    return jnp.clip(offset, -1, 1)


@jax.custom_jvp
def exact_shift(shift: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Shifts rounded so that their sums with pixel coordinates are exact.

    In floating point, the rounding of such a sum grows with the coordinate, so that a part of an
    image would have other positions than the whole.

    Args:
        shift: px.

    Returns:
        The nearest multiples of 1/1024 px in single precision, of 2e-12 px in double precision;
        their sums with coordinates up to 16384 px are exact. Differentiable; the derivative is 1.

    Example:
        >>> float(exact_shift(jnp.float32(0.2))) * 1024
        205.0
    """
    unit = 2.0 ** (13 - jnp.finfo(shift.dtype).nmant)
    return jnp.round(shift / unit) * unit


exact_shift.defjvps(lambda dot, _, shift: dot)


@accepts_numpy
def sample(image: Float[Array, "y x"], xy: Float[Array, "n 2"]) -> Float[Array, " n"]:
    """Bilinear samples of an image; outside, the border repeats.

    Args:
        image: `[y, x]`.
        xy: positions `(x, y)`, px.

    Returns:
        A value per position. Differentiable in both.
    """
    coordinates = [xy[:, 1], xy[:, 0]]
    return jax.scipy.ndimage.map_coordinates(image, coordinates, order=1, mode="nearest")
