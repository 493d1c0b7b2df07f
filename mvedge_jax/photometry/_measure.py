"""Dense labels: where the views themselves put the surface, and how well they know it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Arm
from mvedge_jax._params import cast, number

from ._reach import occlusion_reach


class PhotometricParams(eqx.Module):
    """Parameters of the dense photometric measurement.

    Attributes:
        noise: standard deviation of the images' noise, quantisation and interpolation included, in
            units of sRGB; the floor of what residuals are taken to mean.
        same_surface: neighbours whose disparity differs by much more than this, px, do not take
            part in a pixel's measurement.
        largest_step: a measurement moves by at most this, px per view step.
        outlier: residuals this many times larger than the noise stop counting.
    """

    noise: Float[Array, ""] = number(1.5 / 255)
    same_surface: Float[Array, ""] = number(0.07)
    largest_step: Float[Array, ""] = number(0.1)
    outlier: Float[Array, ""] = number(1.0)


class PhotometricLabels(NamedTuple):
    """A measurement at every pixel.

    Attributes:
        disparity: px per view step, `[y, x]`.
        variance: of the disparity, px², `[y, x]`: residual over contrast.
        residual: variance of the colours over the views that see the pixel, `[y, x]`.
    """

    disparity: Float[Array, "y x"]
    variance: Float[Array, "y x"]
    residual: Float[Array, "y x"]


class _Moments(NamedTuple):
    """Sums over the views that see a pixel: weights, steps, colours, gradients."""

    weight: Array
    step: Array
    square: Array
    colour: tuple[Array, ...]
    slope: tuple[Array, ...]
    power: Array
    gradient: tuple[Array, ...]


class _Normal(NamedTuple):
    """One pixel's normal equation for its disparity, and the residual with its freedom."""

    right: Array
    information: Array
    residual: Array
    freedom: Array


def photometric_labels(
    horizontal: Arm,
    vertical: Arm,
    disparity: Float[Array, "y x"],
    params: PhotometricParams,
    *,
    radius: int,
    passes: int,
) -> PhotometricLabels:
    r"""One Gauss-Newton step of every pixel's disparity towards photo-consistency.

    Around the map given, the colour of a surface point changes from view to view by
    $\bar g\,k\,\delta$: the mean gradient along the arm, the view step, the error of the
    disparity. Regressing the colours on the view steps, over the views that see the point and over
    the neighbours on the same surface, gives $\delta$ with its standard error. Views that the
    map itself hides are left out, those that disagree with the others are weighed down.

    Args:
        horizontal: the horizontal arm, planes holding spline coefficients.
        vertical: the vertical arm, likewise, transposed.
        disparity: the map to improve, px per view step, `[y, x]`.
        params: see `PhotometricParams`.
        radius: how far occluders are looked for, px.
        passes: over the neighbourhood: 1 for 3x3 pixels, 2 for 7x7, 3 for 15x15.

    Returns:
        Labels with their variances. Differentiable with respect to views, disparity, parameters.
    """
    params = cast(params, disparity.dtype)
    across = _arm_normal(horizontal, disparity, params, radius)
    down = _arm_normal(vertical, disparity.T, params, radius)
    own = _Normal(*(a + b.T for a, b in zip(across, down, strict=True)))
    total = _gather(own, disparity, params, passes)
    channels = horizontal.planes.shape[1]
    freedom = jnp.maximum(channels * total.freedom, 1)
    residual = jnp.maximum(total.residual, 0) / freedom
    floor = params.noise**2
    tiny = floor * 1e-6
    step = total.right / (total.information + tiny)
    limit = params.largest_step
    step = limit * jnp.tanh(step / limit)
    variance = jnp.maximum(residual, floor) / (total.information + tiny)
    return PhotometricLabels(disparity + step, variance, residual)


def _gather(own: _Normal, disparity: Array, params: PhotometricParams, passes: int) -> _Normal:
    """Sums the normal equations over neighbours on the same surface.

    Passes over 3x3 pixels, each twice as far apart as the one before: the window of the second is
    7x7, that of the third 15x15, for 9 terms a pass.
    """
    total = own
    for step in (2**i for i in range(passes)):
        total = _gather3(total, disparity, params, step)
    return total


def _gather3(own: _Normal, disparity: Array, params: PhotometricParams, step: int) -> _Normal:
    padded = jax.tree.map(lambda a: jnp.pad(a, step), own)
    near = jnp.pad(disparity, step, mode="edge")
    taps = jnp.asarray([0.5, 1.0, 0.5], disparity.dtype)

    def add(total: _Normal, offset: Array) -> tuple[_Normal, None]:
        row, column = offset // 3, offset % 3
        start = (row * step, column * step)
        other = lax.dynamic_slice(near, start, disparity.shape)
        same = jnp.exp(-(((other - disparity) / params.same_surface) ** 2))
        weight = taps[row] * taps[column] * same
        return jax.tree.map(
            lambda t, p: t + weight * lax.dynamic_slice(p, start, disparity.shape), total, padded
        ), None

    zero = jax.tree.map(jnp.zeros_like, own)
    total, _ = lax.scan(jax.checkpoint(add), zero, jnp.arange(9))
    return total


def _arm_normal(arm: Arm, disparity: Array, params: PhotometricParams, radius: int) -> _Normal:
    """Normal equations of one arm, per pixel."""
    negative, positive = occlusion_reach(disparity, radius=radius, step=0.05)
    columns = jnp.arange(disparity.shape[1], dtype=disparity.dtype)[None, :]
    last = disparity.shape[1] - 1
    channels = arm.planes.shape[1]
    centre, _ = _sample(arm.planes[arm.centre], columns + jnp.zeros_like(disparity))

    @jax.checkpoint
    def look(view: tuple[Array, Array, Array]) -> tuple[Array, ...]:
        planes, step, there = view
        position = columns + step * disparity
        values, slopes = _sample(planes, position)
        reach = jnp.where(step < 0, negative, positive)
        inside = (position >= 0) & (position <= last)
        seen = (step == 0) | (there & inside & (jnp.abs(step) < reach - 0.5))
        relative = tuple(v - c for v, c in zip(values, centre, strict=True))
        return (seen.astype(disparity.dtype), *relative, *slopes)

    seen, *rest = lax.map(look, (arm.planes, arm.steps, arm.available))
    relative, slopes = rest[:channels], rest[channels:]
    first = _moments(seen, arm.steps, relative, slopes)
    weight = _trusted(seen, relative, first, params)
    moments = _moments(weight, arm.steps, relative, slopes)
    return _normal(moments)


def _moments(weight: Array, steps: Array, values: list[Array], slopes: list[Array]) -> _Moments:
    channels = len(values)

    def add(total: _Moments, view: tuple[Array, ...]) -> tuple[_Moments, None]:
        w, k, *rest = view
        colour, gradient = rest[:channels], rest[channels:]
        power = total.power
        for value in colour:
            power = power + w * value * value
        return _Moments(
            total.weight + w,
            total.step + w * k,
            total.square + w * k * k,
            tuple(t + w * v for t, v in zip(total.colour, colour, strict=True)),
            tuple(t + w * k * v for t, v in zip(total.slope, colour, strict=True)),
            power,
            tuple(t + w * v for t, v in zip(total.gradient, gradient, strict=True)),
        ), None

    zero = jnp.zeros_like(weight[0])
    several = (zero,) * channels
    start = _Moments(zero, zero, zero, several, several, zero, several)
    return lax.scan(add, start, (weight, steps, *values, *slopes))[0]


def _trusted(
    seen: Array, values: list[Array], moments: _Moments, params: PhotometricParams
) -> Array:
    """Weights of the views: those far from the mean of the others count less."""
    means = [c / moments.weight for c in moments.colour]
    spread = moments.power
    for mean, colour in zip(means, moments.colour, strict=True):
        spread = spread - mean * colour
    channels = len(values)
    floor = channels * params.noise**2
    scale = params.outlier * jnp.maximum(_box3(spread / moments.weight), floor)

    def one(view: tuple[Array, ...]) -> Array:
        present, *colours = view
        distance = jnp.zeros_like(present)
        for colour, mean in zip(colours, means, strict=True):
            distance = distance + (colour - mean) ** 2
        return present / (1 + _box3(distance) / scale)

    return lax.map(jax.checkpoint(one), (seen, *values))


def _normal(moments: _Moments) -> _Normal:
    mean_step = moments.step / moments.weight
    right = jnp.zeros_like(mean_step)
    contrast = jnp.zeros_like(mean_step)
    residual = moments.power
    for colour, slope, gradient in zip(
        moments.colour, moments.slope, moments.gradient, strict=True
    ):
        mean_gradient = gradient / moments.weight
        right = right - mean_gradient * (slope - mean_step * colour)
        contrast = contrast + mean_gradient * mean_gradient
        residual = residual - colour * colour / moments.weight
    information = contrast * jnp.maximum(moments.square - mean_step * moments.step, 0)
    return _Normal(right, information, residual, moments.weight - 1)


def _sample(
    planes: Float[Array, "c y x"], position: Float[Array, "y x"]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Cubic splines at positions along x, and their derivatives; clamped at the ends."""
    last = planes.shape[-1] - 1
    whole = jnp.floor(position)
    f = position - whole
    index = whole.astype(jnp.int32)
    g = 1 - f
    weights = (
        g * g * g / 6,
        (4 + f * f * (3 * f - 6)) / 6,
        (4 + g * g * (3 * g - 6)) / 6,
        f * f * f / 6,
    )
    derivatives = (-0.5 * g * g, f * (1.5 * f - 2), g * (2 - 1.5 * g), 0.5 * f * f)
    taps = [
        jnp.take_along_axis(planes, jnp.clip(index + j, 0, last)[None], axis=-1)
        for j in (-1, 0, 1, 2)
    ]
    channels = range(planes.shape[0])

    def combine(factors: tuple[Array, ...]) -> tuple[Array, ...]:
        a, b, c, d = factors
        before, at, after, beyond = taps
        return tuple(a * before[i] + b * at[i] + c * after[i] + d * beyond[i] for i in channels)

    return combine(weights), combine(derivatives)


def _box3(image: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Mean over 3x3 pixels, borders repeated."""
    rows = jnp.pad(image, ((1, 1), (0, 0)), mode="edge")
    image = (rows[:-2] + rows[1:-1] + rows[2:]) / 3
    columns = jnp.pad(image, ((0, 0), (1, 1)), mode="edge")
    return (columns[:, :-2] + columns[:, 1:-1] + columns[:, 2:]) / 3
