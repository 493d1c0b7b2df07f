"""Dense labels: where the views themselves put the surface, and how well they know it."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Arm
from mvedge_jax._fence import fenced
from mvedge_jax._params import cast, number
from mvedge_jax._unstack import unstack

from ._filters import box_mean
from ._reach import occlusion_reach
from ._window import weighted_sum

_Tree = TypeVar("_Tree")

# Rounding to eight bits leaves this standard deviation, sRGB, in the best of images.
_ROUNDING = 1 / 255 / 12**0.5
# Where the signal is a smaller share of the information than this, it does not move the map.
_LEAST_SHARE = 1e-4
# Standard error, px, below which neighbours count alike.
_SHARPEST = 0.003


class PhotometricParams(eqx.Module):
    """Parameters of the dense photometric measurement.

    Attributes:
        stiffness: how sure it is that colours do not drift from view to view, in squared view
            steps: 1 says nothing, infinity allows no drift.
        same_surface: neighbours whose disparity differs by much more than this do not take part in
            a pixel's measurement.
        same_colour: nor do those whose CIELAB colour differs by much more than this.
        outlier: residuals this many times larger than the noise stop counting.
    """

    stiffness: Float[Array, ""] = number(1.0, "squared view steps")
    same_surface: Float[Array, ""] = number(0.07, "px")
    same_colour: Float[Array, ""] = number(8.0, "CIELAB")
    outlier: Float[Array, ""] = number(1.0, "noise variances")


class Measuring(PhotometricParams):
    """The same in views of a certain noise, which `sight` says.

    Attributes:
        stiffness: see `PhotometricParams`; larger where noise would pass for drift.
        same_surface: see there.
        same_colour: see there; larger where noise hides the colours of surfaces.
        outlier: see there.
        noise: standard deviation of the images' noise, quantisation and interpolation included, in
            units of sRGB; the floor of what residuals are taken to mean.
        least_noise: the same where standard errors are computed: the mean of a window over many
            views is finer than the step of a single colour.
        gradient_noise: energy of an image's derivative per variance of its noise, 1/px². For white
            noise and cubic splines it is 2.49; blurred views have less.
        largest_step: a measurement moves by at most this, px per view step.
    """

    noise: Float[Array, ""] = number(1.5 / 255, "sRGB")
    least_noise: Float[Array, ""] = number(0.4 / 255, "sRGB")
    gradient_noise: Float[Array, ""] = number(2.5, "1/px²")
    largest_step: Float[Array, ""] = number(0.2, "px")


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


class Look(NamedTuple):
    """What the views show of every pixel around a map: sums that windows add up.

    With the steps `k` of an arm's views, less their weighted mean, colours `r` and mean gradients
    `g` per channel, the map's error `e` and the drift `h` per view step are those that minimise
    the sum of `(r + k (g e - h))²`.

    Attributes:
        right: `-sum k g r` over both arms, `[y, x]`.
        information: `sum k² g²` over both arms, `[y, x]`.
        power: `sum r²` over both arms, `[y, x]`.
        freedom: views that see the pixel less the mean colours that they determine, `[y, x]`.
        spread: `sum k²`, per arm `[y, x]`.
        slope: `sum k² g`, per arm and channel `[y, x]`.
        trend: `sum k r`, per arm and channel `[y, x]`.
    """

    right: Array
    information: Array
    power: Array
    freedom: Array
    spread: tuple[Array, Array]
    slope: tuple[tuple[Array, ...], tuple[Array, ...]]
    trend: tuple[tuple[Array, ...], tuple[Array, ...]]


class _ArmLook(NamedTuple):
    """The fields of a `Look`, of one arm."""

    right: Array
    information: Array
    power: Array
    freedom: Array
    spread: Array
    slope: tuple[Array, ...]
    trend: tuple[Array, ...]


class _Moments(NamedTuple):
    """Sums over the views that see a pixel: weights, steps, colours, gradients."""

    weight: Array
    step: Array
    square: Array
    colour: list[Array]
    trend: list[Array]
    power: Array
    gradient: list[Array]


@partial(jax.jit, static_argnames=("radius", "passes"))
def photometric_labels(
    horizontal: Arm,
    vertical: Arm,
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: Measuring,
    *,
    radius: int,
    passes: int,
) -> PhotometricLabels:
    r"""One Gauss-Newton step of every pixel's disparity towards photo-consistency.

    Around the map given, the colour of a surface point changes from view to view by
    $k\,(\bar g\,\delta + h)$: the view step, the mean gradient along the arm, the error of the
    disparity, and a drift of the colour itself, as gloss and shading have it. Regressing the
    colours on the view steps, over the views that see the point and over the neighbours on the
    same surface, gives $\delta$ with its standard error; the drift, one per channel and arm for a
    window, is eliminated. Views that the map itself hides are left out, those that disagree with
    the others are weighed down.

    The gradient of noise is no information about disparity. What the residual says about the
    noise is therefore subtracted from the information, so that plain surfaces have none.

    Args:
        horizontal: the horizontal arm, planes holding spline coefficients.
        vertical: the vertical arm, likewise, transposed.
        lab: the centre view in CIELAB, `[c, y, x]`.
        disparity: the map to improve, px per view step, `[y, x]`.
        params: see `Measuring`.
        radius: how far occluders are looked for, px.
        passes: over the neighbourhood: 1 for 3x3 pixels, 2 for 7x7, 3 for 15x15.

    Returns:
        Labels with their variances. Differentiable with respect to views, disparity, parameters.

    Source: not in the thesis; DESIGN section 5, "Measurement".
    """
    found = look(horizontal, vertical, disparity, params, radius=radius)
    there = jnp.concatenate([horizontal.available, vertical.available])
    views = 0.5 * jnp.sum(there.astype(disparity.dtype))
    return labels(found, lab, disparity, params, views, passes=passes)


@partial(jax.jit, static_argnames="radius")
def look(
    horizontal: Arm,
    vertical: Arm,
    disparity: Float[Array, "y x"],
    params: Measuring,
    *,
    radius: int,
) -> Look:
    """Reads colours and gradients of all views around a map.

    Args:
        horizontal: the horizontal arm, planes holding spline coefficients.
        vertical: the vertical arm, likewise, transposed.
        disparity: px per view step, `[y, x]`.
        params: see `Measuring`.
        radius: how far occluders are looked for, px.

    Returns:
        What `labels` and `mismatch` read. Differentiable.
    """
    params = cast(params, disparity.dtype)

    def arm_look(arm: Arm, disparity: Array) -> _ArmLook:
        # Stored, or the vertical arm is summed up across the rows in memory.
        return fenced(lambda a, d, p: _arm_look(a, d, p, radius), arm, disparity, params)

    across = arm_look(horizontal, disparity)
    down = jax.tree.map(jnp.transpose, arm_look(vertical, disparity.T))
    return Look(
        across.right + down.right,
        across.information + down.information,
        across.power + down.power,
        across.freedom + down.freedom,
        (across.spread, down.spread),
        (across.slope, down.slope),
        (across.trend, down.trend),
    )


@partial(jax.jit, static_argnames="passes")
def labels(
    found: Look,
    lab: Float[Array, "c y x"],
    disparity: Float[Array, "y x"],
    params: Measuring,
    views: Float[Array, ""],
    *,
    passes: int,
) -> PhotometricLabels:
    """Labels from what the views show; see `photometric_labels`.

    Args:
        found: of `look`, around `disparity`.
        lab: the centre view in CIELAB, `[c, y, x]`.
        disparity: px per view step, `[y, x]`.
        params: see `Measuring`.
        views: number of views in an arm.
        passes: over the neighbourhood.

    Returns:
        Labels with their variances. Differentiable.
    """
    params = cast(params, disparity.dtype)
    total = _gather(found, lab, disparity, params, passes)
    channels = len(total.slope[0])
    right, information, power = total.right, total.information, total.power
    for spread, slope, trend in zip(total.spread, total.slope, total.trend, strict=True):
        held = spread + params.stiffness
        for g, r in zip(slope, trend, strict=True):
            right = right + g * r / held
            information = information - g * g / held
            power = power - r * r / held
    information = jnp.maximum(information, 0)
    freedom = jnp.maximum(channels * total.freedom, 1)
    residual = jnp.maximum(power, 0) / freedom
    floor = params.least_noise**2
    tiny = floor * 1e-6
    # The step explains a part of the residual itself.
    explained = right * right / (information + tiny)
    noise = jnp.maximum(power - explained, 0) / freedom
    spread = total.spread[0] + total.spread[1]
    gradient = params.gradient_noise * channels * spread / views
    signal = jnp.maximum(information - gradient * jnp.maximum(noise, _ROUNDING**2), 0)
    # Without any signal the step is 0. Shares instead of squares: these underflow in float32.
    share = signal / (information + tiny)
    step = right / (information + tiny) * share / (share**2 + _LEAST_SHARE**2)
    limit = params.largest_step
    step = limit * jnp.tanh(step / limit)
    # The right-hand side has the variance of the whole information, the step that of the signal.
    effective = signal * share
    variance = jnp.maximum(noise, floor) / (effective + tiny)
    return PhotometricLabels(disparity + step, variance, residual)


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
    # So that no label is so good that nothing else counts.
    weight = 1 / (measured.variance + _SHARPEST**2)
    total, mean = _gather((weight, weight * own), lab, own, params, passes)
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
    power, freedom = _gather(parts, lab, disparity, params, passes)
    channels = len(found.slope[0])
    return jnp.maximum(power, 0) / jnp.maximum(channels * freedom, 1)


def _gather(own: _Tree, lab: Array, disparity: Array, params: Measuring, passes: int) -> _Tree:
    """Sums over neighbours on the same surface.

    Passes over 3x3 pixels, each twice as far apart as the one before: the window of the second is
    7x7, that of the third 15x15, for 9 terms a pass.
    """
    fields, tree = jax.tree.flatten(own)
    total = jnp.stack(fields)
    for spacing in (2**i for i in range(passes)):
        weights = _alike(lab, disparity, params, spacing)
        # Nothing is known beyond the border.
        total = weighted_sum(total, weights, spacing=spacing, mode="constant")
    return tree.unflatten(unstack(total))


def _alike(lab: Array, disparity: Array, params: Measuring, spacing: int) -> Float[Array, "o y x"]:
    """Weights of 3x3 neighbours by their likeness."""
    height, width = disparity.shape
    margin = (spacing, spacing)
    padded = jnp.pad(jnp.concatenate([disparity[None], lab]), ((0, 0), margin, margin), mode="edge")
    scales = [params.same_surface, *(params.same_colour for _ in lab)]
    taps = jnp.asarray([0.5, 1.0, 0.5], disparity.dtype)

    @jax.checkpoint
    def weigh(offset: Array) -> Array:
        row, column = offset // 3, offset % 3
        start = (0, row * spacing, column * spacing)
        others = lax.dynamic_slice(padded, start, (len(scales), height, width))
        distance = jnp.zeros_like(disparity)
        for own, other, scale in zip([disparity, *lab], others, scales, strict=True):
            distance = distance + ((other - own) / scale) ** 2
        return taps[row] * taps[column] * jnp.exp(-distance)

    return lax.map(weigh, jnp.arange(9))


@partial(jax.jit, static_argnames="radius")
def view_weights(
    horizontal: Arm,
    vertical: Arm,
    disparity: Float[Array, "y x"],
    params: Measuring,
    *,
    radius: int,
) -> Float[Array, "s y x"]:
    """How far each view shows what the centre view shows: the weights that `look` gives them.

    Args:
        horizontal: the horizontal arm, planes holding spline coefficients.
        vertical: the vertical arm, likewise, transposed.
        disparity: px per view step, `[y, x]`.
        params: see `Measuring`.
        radius: how far occluders are looked for, px.

    Returns:
        In [0, 1]: 0 where a nearer surface of the map hides a pixel or the image ends, less than
        one half where colours are further from those of the other views than these are from each
        other. The vertical arm first. Differentiable at the occlusions found.
    """
    params = cast(params, disparity.dtype)

    def weights(arm: Arm, disparity: Array) -> Array:
        found = _arm_views(arm, disparity, params, radius)
        return jnp.insert(found.weight, arm.centre, found.own, axis=0)

    down = jnp.swapaxes(fenced(weights, vertical, disparity.T), 1, 2)
    return jnp.concatenate([down, fenced(weights, horizontal, disparity)])


class _ArmViews(NamedTuple):
    """What the views of an arm but the centre one show, and how far they are trusted."""

    own: Array
    weight: Array
    relative: list[Array]
    gradients: list[Array]
    slopes: list[Array]


def _arm_look(arm: Arm, disparity: Array, params: Measuring, radius: int) -> _ArmLook:
    """The sums of one arm, per pixel."""
    seen = _arm_views(arm, disparity, params, radius)
    steps = arm.steps[_others(arm)]
    return _sums(_moments(seen.weight, steps, seen.relative, seen.gradients, seen.own, seen.slopes))


def _others(arm: Arm) -> np.ndarray:
    return np.delete(np.arange(arm.planes.shape[0]), arm.centre)


def _arm_views(arm: Arm, disparity: Array, params: Measuring, radius: int) -> _ArmViews:
    negative, positive = occlusion_reach(disparity, radius=radius, step=0.05)
    columns = jnp.arange(disparity.shape[1], dtype=disparity.dtype)[None, :]
    last = disparity.shape[1] - 1
    centre, slopes = _sample_whole(arm.planes[arm.centre])

    @jax.checkpoint
    def one(view: tuple[Array, Array, Array]) -> tuple[Array, ...]:
        planes, step, there = view
        position = columns + step * disparity
        values, slopes = _sample(planes, position)
        reach = jnp.where(step < 0, negative, positive)
        inside = (position >= 0) & (position <= last)
        seen = there & inside & (jnp.abs(step) < reach - 0.5)
        relative = tuple(v - c for v, c in zip(values, centre, strict=True))
        return (seen.astype(disparity.dtype), *relative, *slopes)

    # Colours are relative to the centre view, whose own are therefore 0.
    others = _others(arm)
    seen, *rest = lax.map(one, (arm.planes[others], arm.steps[others], arm.available[others]))
    relative, gradients = rest[: len(centre)], rest[len(centre) :]
    first = _moments(seen, arm.steps[others], relative, gradients, jnp.ones_like(disparity), slopes)
    own, weight = _trusted(seen, relative, first, params)
    return _ArmViews(own, weight, relative, gradients, slopes)


def _moments(
    weight: Array,
    steps: Array,
    values: list[Array],
    gradients: list[Array],
    own: Array,
    slopes: list[Array],
) -> _Moments:
    """Sums over the views; `own` and `slopes` are weight and gradients of the centre view."""
    weights, colours = unstack(weight), [unstack(v) for v in values]

    def total(factors: Sequence[Array], images: Sequence[Array] | None = None) -> Array:
        terms = factors if images is None else [f * i for f, i in zip(factors, images, strict=True)]
        return sum(terms[1:], terms[0])

    first = [w * step for w, step in zip(weights, steps, strict=True)]
    second = [w * step**2 for w, step in zip(weights, steps, strict=True)]
    squares = [_square(of) for of in zip(*colours, strict=True)]
    return _Moments(
        own + total(weights),
        total(first),
        total(second),
        [total(weights, colour) for colour in colours],
        [total(first, colour) for colour in colours],
        total(weights, squares),
        [own * s + total(weights, unstack(g)) for s, g in zip(slopes, gradients, strict=True)],
    )


def _square(colour: Sequence[Array]) -> Array:
    total = colour[0] ** 2
    for channel in colour[1:]:
        total = total + channel**2
    return total


def _trusted(
    seen: Array, values: list[Array], moments: _Moments, params: Measuring
) -> tuple[Array, Array]:
    """Weights of the centre view and of the others: those far from the mean count less."""
    means = [c / moments.weight for c in moments.colour]
    spread = moments.power
    for mean, colour in zip(means, moments.colour, strict=True):
        spread = spread - mean * colour
    floor = len(values) * params.noise**2
    scale = params.outlier * jnp.maximum(box_mean(spread / moments.weight, 1), floor)

    def one(view: tuple[Array, ...]) -> Array:
        present, *colours = view
        distance = jnp.zeros_like(present)
        for colour, mean in zip(colours, means, strict=True):
            distance = distance + (colour - mean) ** 2
        return present / (1 + box_mean(distance, 1) / scale)

    nothing = jnp.zeros_like(scale)
    own = one((jnp.ones_like(scale), *(nothing for _ in values)))
    return own, lax.map(jax.checkpoint(one), (seen, *values))


def _sums(moments: _Moments) -> _ArmLook:
    mean_step = moments.step / moments.weight
    spread = jnp.maximum(moments.square - mean_step * moments.step, 0)
    gradients = [g / moments.weight for g in moments.gradient]
    trends = [t - mean_step * c for t, c in zip(moments.trend, moments.colour, strict=True)]
    right = jnp.zeros_like(mean_step)
    contrast = jnp.zeros_like(mean_step)
    power = moments.power
    for colour, trend, gradient in zip(moments.colour, trends, gradients, strict=True):
        right = right - gradient * trend
        contrast = contrast + gradient * gradient
        power = power - colour * colour / moments.weight
    return _ArmLook(
        right,
        contrast * spread,
        power,
        moments.weight - 1,
        spread,
        tuple(spread * g for g in gradients),
        tuple(trends),
    )


def _sample_whole(planes: Float[Array, "c y x"]) -> tuple[list[Array], list[Array]]:
    """Cubic splines and their derivatives at the pixels themselves."""
    padded = jnp.pad(planes, ((0, 0), (0, 0), (1, 1)), mode="edge")
    before, after = padded[..., :-2], padded[..., 2:]
    values, slopes = (before + 4 * planes + after) / 6, 0.5 * (after - before)
    return list(values), list(slopes)


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
