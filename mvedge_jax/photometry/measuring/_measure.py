"""Dense labels: where the views themselves put the surface, and how well they know it."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import unstack
from mvedge_jax._params import cast
from mvedge_jax._root import root
from mvedge_jax.image import box_mean

from .._window import weighted_sum
from ._look import Look
from ._measuring import Measuring

_Tree = TypeVar("_Tree")
_Pair = tuple[Array, Array]


class PhotometricLabels(NamedTuple):
    """A measurement at every pixel.

    Attributes:
        disparity: px per view step, `[y, x]`.
        variance: of the disparity, px², `[y, x]`: residual over contrast, and what no residual
            tells (`Measurement.error_floor`).
        residual: variance of the colours over the views that see the pixel, `[y, x]`.
    """

    disparity: Float[Array, "y x"]
    variance: Float[Array, "y x"]
    residual: Float[Array, "y x"]

    def weight(
        self, params: Measuring, *, precision: Float[Array, ""], trust: Float[Array, ""]
    ) -> Float[Array, "y x"]:
        """Data weight of the labels: by standard error, and by how well the views agree.

        Args:
            params: of the measurement.
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
    found: Look,
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: Measuring,
    *,
    passes: int,
) -> PhotometricLabels:
    r"""One Gauss-Newton step of every pixel's disparity towards photo-consistency.

    Around the map given, the colour of a surface point changes from view to view by
    $k\,(\bar g\,\delta + h)$: the view step, the mean gradient along the step, the error of the
    disparity, and a drift of the colour itself, as gloss and shading have it. Regressing the
    colours on the view steps, over the views that see the point and over the neighbours on the
    same surface, gives $\delta$ with its standard error; the drift, one per channel and axis for a
    window, is eliminated. Views that the map itself hides are left out, those that disagree with
    the others are weighed down.

    The gradient of noise is no information about disparity. What the residual says about the
    noise is therefore subtracted from the information, so that plain surfaces have none.

    Args:
        found: what the views show around `disparity`, see `CrosshairSplines.look`.
        lab: the centre view in CIELAB, `[c, y, x]`.
        disparity: the map to improve, px per view step, `[y, x]`.
        params: see `Measuring`.
        passes: over the neighbourhood: 1 for 3x3 pixels, 2 for 7x7, 3 for 15x15.

    Returns:
        Labels with their variances. Differentiable.

    Source: not in the thesis; Lucas and Kanade (1981), "An iterative image registration technique",
        for one step along a line of views.
    """
    params = cast(params, disparity.dtype)
    unlike = _unlike(lab, disparity, params, _uncertain(found, params))
    total = _gather(found._replace(views=None), unlike, passes)
    channels = len(total.slope[0])
    floor = (params.least_noise * params.rounding) ** 2
    tiny = floor * 1e-6
    freedom = jnp.maximum(channels * total.freedom, 1)
    wider = partial(_gathered, unlike=unlike, spacing=2**passes)
    stiffness = _stiffness(total, params, floor, wider)
    right, information, power = _regressed(total, stiffness)
    residual = jnp.maximum(power, 0) / freedom
    # The step explains a part of the residual itself.
    noise = jnp.maximum(power - _explained(right, information, tiny), 0) / freedom
    spread = total.spread[0] + total.spread[1]
    gradient = params.gradient_noise * channels * spread / found.views
    signal = jnp.maximum(information - gradient * jnp.maximum(noise, params.rounding**2), 0)
    # Without any signal the step is 0. Shares instead of squares: these underflow in float32.
    share = _over(signal, information + tiny)
    step = _over(right, information + tiny) * share / (share**2 + params.least_share**2)
    limit = params.largest_step
    step = limit * jnp.tanh(step / limit)
    # The right-hand side has the variance of the whole information, the step that of the signal.
    effective = signal * share
    variance = _over(jnp.maximum(noise, floor), effective + tiny) + params.error_floor**2
    return PhotometricLabels(disparity + step, variance, residual)


def _stiffness(
    total: Look, params: Measuring, floor: Array, wider: Callable[[_Pair], _Pair]
) -> Array:
    """How little the drift of every window is believed in, in squared view steps.

    Matt surfaces have none, and looking for it there costs a part of the information; on glossy
    ones it is what there is to explain. The surroundings tell: what drifts explain in them,
    beyond disparities, is compared with what as many numbers explain of noise.
    """
    channels, tiny = len(total.slope[0]), floor * 1e-6
    right, information, left = _regressed(total, params.stiffness)
    left = jnp.maximum(left - _explained(right, information, tiny), 0)
    rigid = jnp.maximum(total.power - _explained(total.right, total.information, tiny), 0)
    axes = sum(spread / (spread + params.stiffness) for spread in total.spread)
    noise = jnp.maximum(left / jnp.maximum(channels * total.freedom, 1), floor)
    gain, noise = wider((jnp.maximum(rigid - left, 0), channels * axes * noise))
    evidence = _over(gain, noise + tiny)
    doubt = params.drift / (evidence + params.surest * params.drift + tiny)
    spread = 0.5 * (total.spread[0] + total.spread[1])
    return params.stiffness + spread * doubt**4


def _regressed(total: Look, stiffness: Array) -> tuple[Array, Array, Array]:
    """Right-hand side, information and power of a window, less what its drift explains."""
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
    """What the step of the disparity takes off the power."""
    return _over(right * right, information + tiny)


def _over(part: Array, whole: Array) -> Array:
    """A quotient whose transpose meets what is small before the inverse square of what is.

    That of a division multiplies large cotangents by the inverse square first, beyond float32.
    """
    return part * (1 / whole)


def _undrifted(total: Look, sums: tuple[Array, Array], stiffness: Array) -> tuple[Array, Array]:
    """The drift that explains sums over views times their steps."""
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
def shared(
    measured: PhotometricLabels,
    lab: Float[Array, "c y x"],
    params: Measuring,
    *,
    passes: int,
) -> PhotometricLabels:
    """Labels averaged with those of neighbours on the same surface, by their precision.

    A step of `labels` is that of a window, taken from every pixel's own start: what the starts
    scatter by is still in the labels.

    Args:
        measured: of `labels`.
        lab: the centre view in CIELAB, `[c, y, x]`.
        params: see `Measuring`.
        passes: over the neighbourhood, see `labels`.

    Returns:
        The averages; variance and residual are those of the pixel itself, since neighbours were
        measured in windows that overlap. Differentiable.
    """
    params = cast(params, lab.dtype)
    own = measured.disparity
    weight = 1 / measured.variance
    unlike = _told_apart(lab, own, params, params.scatter * params.same_surface)
    total, mean = _gather((weight, weight * own), unlike, passes)
    return measured._replace(disparity=mean / total)


@partial(jax.jit, static_argnames="passes")
def mismatch(
    found: Look,
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: Measuring,
    *,
    passes: int,
) -> Float[Array, "y x"]:
    """Variance of the colours of every window over the views that see it, drift included.

    Args:
        found: of `look`, around `disparity`.
        lab: the centre view in CIELAB, `[c, y, x]`.
        disparity: px per view step, `[y, x]`.
        params: see `Measuring`.
        passes: over the neighbourhood.

    Returns:
        Squared sRGB, `[y, x]`. Differentiable.
    """
    params = cast(params, disparity.dtype)
    parts = found.power, found.freedom
    unlike = _unlike(lab, disparity, params, _uncertain(found, params))
    power, freedom = _gather(parts, unlike, passes)
    channels = len(found.slope[0])
    return jnp.maximum(power, 0) / jnp.maximum(channels * freedom, 1)


class _Unlike(NamedTuple):
    """By what neighbours are told from those on the same surface.

    Attributes:
        planes: disparity and colours, `[n, y, x]`.
        scales: differences that tell, likewise.
    """

    planes: Array
    scales: Array


def _uncertain(found: Look, params: Measuring) -> Array:
    """Variance of the disparity by the 3x3 pixels around; large on plain surfaces, but finite."""
    information, noise = 9 * box_mean(found.information, 1), params.noise**2
    return _over(noise, information + 1e-6 * noise)


def _unlike(lab: Array, disparity: Array, params: Measuring, variance: Array) -> _Unlike:
    """What tells surfaces apart: disparities tell less where they are known less well."""
    same = params.same_surface**2
    most = params.plain**2 * same
    apart = root(same + most * _over(variance, most + variance))
    return _told_apart(lab, disparity, params, apart)


def _told_apart(lab: Array, disparity: Array, params: Measuring, apart: Array) -> _Unlike:
    """What tells surfaces apart, the difference of disparities that does given."""
    colours = jnp.broadcast_to(params.same_colour, lab.shape)
    apart = jnp.broadcast_to(apart, (1, *disparity.shape))
    return _Unlike(jnp.concatenate([disparity[None], lab]), jnp.concatenate([apart, colours]))


def _gather(own: _Tree, unlike: _Unlike, passes: int) -> _Tree:
    """Sums over neighbours on the same surface.

    Passes over 3x3 pixels, each twice as far apart as the one before: the window of the second is
    7x7, that of the third 15x15, for 9 terms a pass.
    """
    for i in range(passes):
        own = _gathered(own, unlike, spacing=2**i)
    return own


def _gathered(own: _Tree, unlike: _Unlike, spacing: int) -> _Tree:
    """One pass of `_gather`."""
    fields, tree = jax.tree.flatten(own)
    weights = _alike(unlike, spacing)
    # Nothing is known beyond the border.
    total = weighted_sum(jnp.stack(fields), weights, spacing=spacing, mode="constant")
    return tree.unflatten(unstack(total))


def _alike(unlike: _Unlike, spacing: int) -> Float[Array, "o y x"]:
    """Weights of 3x3 neighbours by their likeness."""
    own, scales = unlike
    margin = (spacing, spacing)
    padded = jnp.pad(own, ((0, 0), margin, margin), mode="edge")
    taps = jnp.asarray([0.5, 1.0, 0.5], own.dtype)

    @jax.checkpoint
    def weigh(offset: Array) -> Array:
        row, column = offset // 3, offset % 3
        start = (0, row * spacing, column * spacing)
        others = lax.dynamic_slice(padded, start, own.shape)
        distance = jnp.sum(((others - own) / scales) ** 2, axis=0)
        return taps[row] * taps[column] * jnp.exp(-distance)

    return lax.map(weigh, jnp.arange(9))
