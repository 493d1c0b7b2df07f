"""Dense labels: disparity and standard error of every pixel from the views."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import plane_sum, unstack
from mvedge_jax._params import cast
from mvedge_jax._root import safe_sqrt
from mvedge_jax.image import box_mean

from .._window import weighted_sum
from ._crosshair import NormalEquations
from ._measuring import AdaptedMeasurement

_Tree = TypeVar("_Tree")
_Pair = tuple[Array, Array]


class PhotometricLabels(NamedTuple):
    """A measurement at every pixel.

    Attributes:
        disparity: px per view step, `[y, x]`.
        variance: variance of the disparity, px², `[y, x]`: residual over contrast, plus the error
            that views share (`Measurement.error_floor`).
        residual: variance of the colors over the views that show the pixel, `[y, x]`.
    """

    disparity: Float[Array, "y x"]
    variance: Float[Array, "y x"]
    residual: Float[Array, "y x"]

    def weight(
        self, params: AdaptedMeasurement, *, precision: Float[Array, ""], trust: Float[Array, ""]
    ) -> Float[Array, "y x"]:
        """Data weight of the labels by standard error and residual.

        Args:
            params: parameters of the measurement.
            precision: standard error, px, at which a label counts half as much as a perfect one.
            trust: residual, in multiples of the noise variance, that halves the weight.

        Returns:
            Weights in [0, 1]. Differentiable.
        """
        floor = params.noise**2
        excess = jnp.maximum(self.residual, floor) / (trust * floor)
        return precision**2 / (precision**2 + self.variance) / (1 + excess**2)


@partial(jax.jit, static_argnames="passes")
def labels(
    equations: NormalEquations,
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: AdaptedMeasurement,
    *,
    passes: int,
) -> PhotometricLabels:
    r"""One Gauss-Newton step of every pixel's disparity towards photo-consistency.

    Around the given map, the color of a surface point changes from view to view by $k\,(\bar
    g\,\delta + h)$ with the view step $k$, the mean gradient $\bar g$ along the step, the error
    $\delta$ of the disparity, and a drift $h$ of the color by gloss and shading. Colors are
    regressed on view steps, over the views that show the point and over the neighbors on the same
    surface. This gives $\delta$ with its standard error; the drift, one per channel and axis of a
    window, is eliminated. Views in which the map hides the point are left out; views that disagree
    with the others get less weight.

    The gradient of noise has no information about disparity. Its energy, by the residual, is
    therefore subtracted from the information, so that plain surfaces have none.

    Args:
        equations: normal equations around `disparity`, see `CrosshairSplines.accumulate`.
        lab: the center view in CIELAB, `[c, y, x]`.
        disparity: the map to improve, px per view step, `[y, x]`.
        params: see `AdaptedMeasurement`.
        passes: passes over the neighborhood: 1 for 3x3 pixels, 2 for 7x7, 3 for 15x15.

    Returns:
        Labels with their variances. Differentiable.

    Source: not in the thesis; Lucas and Kanade (1981), "An iterative image registration technique",
        for one step along a line of views.
    """
    params = cast(params, disparity.dtype)
    features = _features(lab, disparity, params, _tolerance(equations, params))
    total = _sum_over_surface(equations._replace(views=None), features, passes)
    channels = len(total.slope[0])
    floor = (params.least_noise * params.rounding) ** 2
    tiny = floor * 1e-6
    freedom = jnp.maximum(channels * total.freedom, 1)
    wider = partial(_sum_over_neighbors, features=features, spacing=2**passes)
    stiffness = _stiffness(total, params, floor, wider)
    right, information, power = _regressed(total, stiffness)
    residual = jnp.maximum(power, 0) / freedom
    # The step explains a part of the residual.
    noise = jnp.maximum(power - _explained(right, information, tiny), 0) / freedom
    spread = total.spread[0] + total.spread[1]
    gradient = params.gradient_noise * channels * spread / equations.views
    signal = jnp.maximum(information - gradient * jnp.maximum(noise, params.rounding**2), 0)
    # Without any signal the step is 0. Shares instead of squares: these underflow in float32.
    share = _divide(signal, information + tiny)
    step = _divide(right, information + tiny) * share / (share**2 + params.least_share**2)
    limit = params.largest_step
    step = limit * jnp.tanh(step / limit)
    # The variance of the right-hand side is by the whole information, the step by the signal.
    effective = signal * share
    variance = _divide(jnp.maximum(noise, floor), effective + tiny) + params.error_floor**2
    return PhotometricLabels(disparity + step, variance, residual)


def _stiffness(
    total: NormalEquations,
    params: AdaptedMeasurement,
    floor: Array,
    wider: Callable[[_Pair], _Pair],
) -> Array:
    """Stiffness of the prior that holds the drift of every window at 0, in squared view steps.

    Matt surfaces have no drift, and estimating one costs a part of the information; glossy ones
    need it. The reduction of the residual by drifts, in the surroundings of a pixel, is compared
    with the reduction by as many parameters in noise.
    """
    channels, tiny = len(total.slope[0]), floor * 1e-6
    right, information, left = _regressed(total, params.stiffness)
    left = jnp.maximum(left - _explained(right, information, tiny), 0)
    rigid = jnp.maximum(total.power - _explained(total.right, total.information, tiny), 0)
    axes = sum(spread / (spread + params.stiffness) for spread in total.spread)
    noise = jnp.maximum(left / jnp.maximum(channels * total.freedom, 1), floor)
    gain, noise = wider((jnp.maximum(rigid - left, 0), channels * axes * noise))
    evidence = _divide(gain, noise + tiny)
    doubt = params.drift / (evidence + params.surest * params.drift + tiny)
    spread = 0.5 * (total.spread[0] + total.spread[1])
    return params.stiffness + spread * doubt**4


def _regressed(total: NormalEquations, stiffness: Array) -> tuple[Array, Array, Array]:
    """Right-hand side, information and power of a window after elimination of the drift."""
    right, information, power = total.right, total.information, total.power
    for slope, trend in zip(
        zip(*total.slope, strict=True), zip(*total.trend, strict=True), strict=True
    ):
        along = _undrifted(total, slope, stiffness)
        right = right + _dot(along, trend)
        information = information - _dot(along, slope)
        power = power - _dot(_undrifted(total, trend, stiffness), trend)
    return right, jnp.maximum(information, 0), power


def _explained(right: Array, information: Array, tiny: Array) -> Array:
    """Reduction of the power by the step of the disparity."""
    return _divide(right * right, information + tiny)


def _divide(part: Array, whole: Array) -> Array:
    """A quotient whose transpose multiplies by small factors first.

    The transpose of a division first multiplies cotangents by the inverse square, which overflows.
    """
    return part * (1 / whole)


def _undrifted(
    total: NormalEquations, sums: tuple[Array, Array], stiffness: Array
) -> tuple[Array, Array]:
    """The drift, from sums over views times their steps."""
    xx, yy = (spread + stiffness for spread in total.spread)
    x, y = sums
    if total.cross is None:
        return x / xx, y / yy
    xy = total.cross
    determinant = xx * yy - xy * xy
    return (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant


def _dot(a: tuple[Array, Array], b: tuple[Array, Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1]


@partial(jax.jit, static_argnames="passes")
def average_over_surface(
    measured: PhotometricLabels,
    lab: Float[Array, "c y x"],
    params: AdaptedMeasurement,
    *,
    passes: int,
) -> PhotometricLabels:
    """Averages labels with those of neighbors on the same surface, weighted by their precision.

    A step of `labels` is that of a window, taken from every pixel's own start, so the scatter of
    the starts is still in the labels.

    Args:
        measured: result of `labels`.
        lab: the center view in CIELAB, `[c, y, x]`.
        params: see `AdaptedMeasurement`.
        passes: passes over the neighborhood, see `labels`.

    Returns:
        The averages, with variance and residual of the pixel itself, because the windows of
        neighbors overlap. Differentiable.
    """
    params = cast(params, lab.dtype)
    own = measured.disparity
    weight = 1 / measured.variance
    features = _features(lab, own, params, params.scatter * params.same_surface)
    total, mean = _sum_over_surface((weight, weight * own), features, passes)
    return measured._replace(disparity=mean / total)


@partial(jax.jit, static_argnames="passes")
def residual_variance(
    equations: NormalEquations,
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: AdaptedMeasurement,
    *,
    passes: int,
) -> Float[Array, "y x"]:
    """Residual variance of every window's colors over the views, drift included.

    Args:
        equations: result of `accumulate` around `disparity`.
        lab: the center view in CIELAB, `[c, y, x]`.
        disparity: px per view step, `[y, x]`.
        params: see `AdaptedMeasurement`.
        passes: passes over the neighborhood.

    Returns:
        Squared sRGB, `[y, x]`. Differentiable.
    """
    params = cast(params, disparity.dtype)
    parts = equations.power, equations.freedom
    features = _features(lab, disparity, params, _tolerance(equations, params))
    power, freedom = _sum_over_surface(parts, features, passes)
    channels = len(equations.slope[0])
    return jnp.maximum(power, 0) / jnp.maximum(channels * freedom, 1)


class _SurfaceFeatures(NamedTuple):
    """Disparity and colors, by which neighbors on the same surface are recognized."""

    planes: Array
    scales: Array  # significant differences


def _tolerance(equations: NormalEquations, params: AdaptedMeasurement) -> Array:
    """Tolerance of the disparity on a surface, which grows with its variance by 3x3 pixels."""
    information, noise = 9 * box_mean(equations.information, 1), params.noise**2
    # Large on plain surfaces, but finite.
    variance = _divide(noise, information + 1e-6 * noise)
    same = params.same_surface**2
    most = params.plain**2 * same
    return safe_sqrt(same + most * _divide(variance, most + variance))


def _features(
    lab: Array, disparity: Array, params: AdaptedMeasurement, tolerance: Array
) -> _SurfaceFeatures:
    colors = jnp.broadcast_to(params.same_color, lab.shape)
    tolerance = jnp.broadcast_to(tolerance, (1, *disparity.shape))
    planes, scales = jnp.concatenate([disparity[None], lab]), jnp.concatenate([tolerance, colors])
    return _SurfaceFeatures(planes, scales)


def _sum_over_surface(own: _Tree, features: _SurfaceFeatures, passes: int) -> _Tree:
    """Sums over neighbors on the same surface.

    Each pass sums over 3x3 pixels, twice as far apart as in the pass before: the window of the
    second is 7x7, that of the third 15x15, for 9 terms a pass.
    """
    for i in range(passes):
        own = _sum_over_neighbors(own, features, spacing=2**i)
    return own


def _sum_over_neighbors(own: _Tree, features: _SurfaceFeatures, spacing: int) -> _Tree:
    """One pass of `_sum_over_surface`."""
    fields, tree = jax.tree.flatten(own)
    weights = _surface_weights(features, spacing)
    # There is no data beyond the border.
    total = weighted_sum(jnp.stack(fields), weights, spacing=spacing, mode="constant")
    return tree.unflatten(unstack(total))


def _surface_weights(features: _SurfaceFeatures, spacing: int) -> Float[Array, "o y x"]:
    """Weights of 3x3 neighbors by their similarity."""
    own, scales = features
    padded = jnp.pad(own, ((0, 0), (spacing, spacing), (spacing, spacing)), mode="edge")
    taps = jnp.asarray([0.5, 1.0, 0.5], own.dtype)

    @jax.checkpoint
    def weigh(offset: Array) -> Array:
        row, column = offset // 3, offset % 3
        start = (0, row * spacing, column * spacing)
        others = lax.dynamic_slice(padded, start, own.shape)
        distance = plane_sum(((others - own) / scales) ** 2)
        return taps[row] * taps[column] * jnp.exp(-distance)

    return lax.map(weigh, jnp.arange(9))
