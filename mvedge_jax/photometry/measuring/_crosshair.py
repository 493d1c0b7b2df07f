"""Normal equations over the views of the crosshair, around a map."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._cpu import no_fuse, plane_sum
from mvedge_jax._crosshair import Arm, Crosshair
from mvedge_jax._params import cast
from mvedge_jax.image import box_mean
from mvedge_jax.interpolation import cubic_taps, spline_coefficients

from ._measuring import AdaptedMeasurement
from ._visible_range import visible_view_range


class ArmSplines(NamedTuple):
    """The views of an arm as coefficients of cubic splines along it.

    Attributes:
        center: coefficients of the center view.
        others: coefficients of the other views, separate to avoid copies.
        steps: view steps from the center view to each other one.
        available: which of the other views are read.
    """

    center: Float[Array, "c y x"]
    others: Float[Array, "s c y x"]
    steps: Float[Array, " s"]
    available: Bool[Array, " s"]

    @staticmethod
    def of(arm: Arm) -> "ArmSplines":
        """Coefficients of an arm. Differentiable in the colors."""
        planes, own = spline_coefficients(arm.planes, axis=-1), arm.center

        def others(of: Array) -> Array:
            return jnp.concatenate([of[:own], of[own + 1 :]])

        return ArmSplines(planes[own], others(planes), others(arm.steps), others(arm.available))


class NormalEquations(NamedTuple):
    """Normal equations of every pixel around a map: sums over views, which windows add up.

    Let `k = (k_x, k_y)` be the steps of the views minus their weighted mean, `r` the colors and
    `g` the mean gradients per channel. The map's error `e` and the drift `h` per view step
    minimize the sum of `(r + k . (g e - h))²`. Each arm of the crosshair has steps along one axis
    only, and a mean of its own.

    Attributes:
        right: `-sum (k . g) r`, `[y, x]`.
        information: `sum (k . g)²`, `[y, x]`.
        power: `sum r²`, `[y, x]`.
        freedom: degrees of freedom: views that show the pixel minus mean colors, `[y, x]`.
        views: number of views whose gradients were averaged (of the crosshair, those of an arm), a
            scalar or one per pixel.
        spread: `sum k_x²` and `sum k_y²`, `[y, x]`.
        cross: `sum k_x k_y`, `[y, x]`; None for the crosshair, which has none.
        slope: `sum k_x (k . g)` and `sum k_y (k . g)`, per channel `[y, x]`.
        trend: `sum k_x r` and `sum k_y r`, per channel `[y, x]`.
    """

    right: Array
    information: Array
    power: Array
    freedom: Array
    views: Array
    spread: tuple[Array, ...]
    cross: Array | None
    slope: tuple[tuple[Array, ...], ...]
    trend: tuple[tuple[Array, ...], ...]

    def per_pixel(self) -> "NormalEquations":
        """The same with `views` per pixel, so that two of them can be mixed by pixel."""
        return self._replace(views=jnp.broadcast_to(self.views, self.right.shape))


class _Moments(NamedTuple):
    """Sums over the views that show a pixel: weights, steps, colors, gradients."""

    weight: Array
    step: Array
    square: Array
    color: list[Array]
    trend: list[Array]
    power: Array
    gradient: list[Array]


class CrosshairSplines(NamedTuple):
    """Spline coefficients of the views of a crosshair.

    Attributes:
        horizontal: the horizontal arm.
        vertical: the vertical arm, transposed.
    """

    horizontal: ArmSplines
    vertical: ArmSplines

    @staticmethod
    def of(arms: Crosshair) -> "CrosshairSplines":
        """Coefficients of both arms. Differentiable in the colors."""
        return CrosshairSplines(*map(ArmSplines.of, arms))

    @jax.jit
    def accumulate(
        self, disparity: Float[Array, "y x"], params: AdaptedMeasurement
    ) -> NormalEquations:
        """Accumulates colors and gradients of all views around a map.

        Args:
            disparity: px per view step, `[y, x]`.
            params: see `AdaptedMeasurement`.

        Returns:
            Inputs of `labels` and `residual_variance`. Differentiable.
        """
        return self.accumulate_with_weights(disparity, params)[0]

    @jax.jit
    def accumulate_with_weights(
        self, disparity: Float[Array, "y x"], params: AdaptedMeasurement
    ) -> tuple[NormalEquations, Float[Array, "s y x"]]:
        """`accumulate`, and the weight of each view at every pixel.

        Args:
            disparity: px per view step, `[y, x]`.
            params: see `AdaptedMeasurement`.

        Returns:
            The normal equations; the weights of the views, those of the vertical arm first, in [0,
            1]: 0 where a nearer surface of the map hides a pixel or the image ends, less than one
            half where colors differ more from the other views than these from each other.
            Differentiable at the occlusions chosen.
        """
        params = cast(params, disparity.dtype)

        def sums(arm: ArmSplines, disparity: Array) -> tuple[NormalEquations, Array]:
            views = _arm_views(arm, disparity, params)
            weights = jnp.insert(views.weight, arm.others.shape[0] // 2, views.own, axis=0)
            return _sums(views, arm), weights

        across, own = no_fuse(sums, self.horizontal, disparity)
        # Stored; otherwise the vertical arm is summed across the rows in memory.
        down, turned = no_fuse(sums, self.vertical, disparity.T)
        down = jax.tree.map(jnp.transpose, down)
        equations = NormalEquations(
            *(a + d for a, d in zip(across[:5], down[:5], strict=True)),
            spread=across.spread + down.spread,
            cross=None,
            slope=across.slope + down.slope,
            trend=across.trend + down.trend,
        )
        return equations, jnp.concatenate([jnp.swapaxes(turned, 1, 2), own])


class _ArmViews(NamedTuple):
    """Colors, gradients and weights of the views of an arm without the center view."""

    own: Array
    weight: Array
    relative: list[Array]
    gradients: list[Array]
    slopes: list[Array]


def _arm_views(arm: ArmSplines, disparity: Array, params: AdaptedMeasurement) -> _ArmViews:
    negative, positive = visible_view_range(disparity, radius=params.radius, step=params.slant)
    columns = jnp.arange(disparity.shape[1], dtype=disparity.dtype)[None, :]
    last = disparity.shape[1] - 1
    center, slopes = _sample_whole(arm.center)

    @jax.checkpoint
    def one(view: tuple[Array, Array, Array]) -> tuple[Array, ...]:
        planes, step, there = view
        shift = step * disparity
        values, slopes = _sample(planes, shift)
        reach = jnp.where(step < 0, negative, positive)
        position = columns + shift
        inside = (position >= 0) & (position <= last)
        seen = there & inside & (jnp.abs(step) < reach - 0.5)
        relative = tuple(v - c for v, c in zip(values, center, strict=True))
        return (seen.astype(disparity.dtype), *relative, *slopes)

    # Colors are relative to the center view, whose own are therefore 0.
    seen, *rest = lax.map(one, (arm.others, arm.steps, arm.available))
    relative, gradients = rest[: len(center)], rest[len(center) :]
    first = _moments(seen, arm.steps, relative, gradients, jnp.ones_like(disparity), slopes)
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
    """Sums over the views; `own` and `slopes` are weight and gradients of the center view."""
    step = steps[:, None, None]
    first = weight * step
    return _Moments(
        own + plane_sum(weight),
        plane_sum(first),
        plane_sum(first * step),
        [plane_sum(weight * color) for color in values],
        [plane_sum(first * color) for color in values],
        plane_sum(weight * sum((c**2 for c in values[1:]), values[0] ** 2)),
        [own * s + plane_sum(weight * g) for s, g in zip(slopes, gradients, strict=True)],
    )


def _trusted(
    seen: Array, values: list[Array], moments: _Moments, params: AdaptedMeasurement
) -> tuple[Array, Array]:
    """Weights of the center view and of the others: outliers from the mean weigh less."""
    means = [c / moments.weight for c in moments.color]
    spread = moments.power
    for mean, color in zip(means, moments.color, strict=True):
        spread = spread - mean * color
    floor = len(values) * params.noise**2
    scale = params.outlier * jnp.maximum(box_mean(spread / moments.weight, 1), floor)

    def one(view: tuple[Array, ...]) -> Array:
        present, *colors = view
        distance = jnp.zeros_like(present)
        for color, mean in zip(colors, means, strict=True):
            distance = distance + (color - mean) ** 2
        return present / (1 + box_mean(distance, 1) / scale)

    own = one((jnp.ones_like(scale), *(jnp.zeros_like(scale) for _ in values)))
    return own, lax.map(jax.checkpoint(one), (seen, *values))


def _sums(seen: _ArmViews, arm: ArmSplines) -> NormalEquations:
    """The sums of one arm, whose steps have one axis, per pixel."""
    moments = _moments(seen.weight, arm.steps, seen.relative, seen.gradients, seen.own, seen.slopes)
    mean_step = moments.step / moments.weight
    spread = jnp.maximum(moments.square - mean_step * moments.step, 0)
    gradients = [g / moments.weight for g in moments.gradient]
    trends = [t - mean_step * c for t, c in zip(moments.trend, moments.color, strict=True)]
    right = jnp.zeros_like(mean_step)
    contrast = jnp.zeros_like(mean_step)
    power = moments.power
    for color, trend, gradient in zip(moments.color, trends, gradients, strict=True):
        right = right - gradient * trend
        contrast = contrast + gradient * gradient
        power = power - color * color / moments.weight
    slope = tuple(spread * g for g in gradients)
    # Half of them, because the sums of both arms are added.
    views = 0.5 * (1 + jnp.sum(arm.available.astype(power.dtype)))
    freedom, trend = moments.weight - 1, tuple(trends)
    return NormalEquations(
        right, contrast * spread, power, freedom, views, (spread,), None, (slope,), (trend,)
    )


def _sample_whole(planes: Float[Array, "c y x"]) -> tuple[list[Array], list[Array]]:
    """Cubic splines and their derivatives at the pixels themselves."""
    padded = jnp.pad(planes, ((0, 0), (0, 0), (1, 1)), mode="edge")
    before, after = padded[..., :-2], padded[..., 2:]
    values, slopes = (before + 4 * planes + after) / 6, 0.5 * (after - before)
    return list(values), list(slopes)


def _sample(
    planes: Float[Array, "c y x"], shift: Float[Array, "y x"]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Cubic splines beside the pixels, and their derivatives; clamped at the ends.

    The shift along x is split before the column is added, whose rounding grows to the right.
    """
    last = planes.shape[-1] - 1
    whole = jnp.floor(shift)
    weights, derivatives = cubic_taps(shift - whole)
    index = jnp.arange(last + 1, dtype=jnp.int32)[None, :] + whole.astype(jnp.int32)

    def tap(offset: int) -> Array:
        # Without checks, which take longer than the reading.
        places = jnp.clip(index + offset, 0, last)[None]
        return jnp.take_along_axis(planes, places, axis=-1, mode="promise_in_bounds")

    taps = [tap(offset) for offset in (-1, 0, 1, 2)]
    channels = range(planes.shape[0])

    def combine(factors: tuple[Array, ...]) -> tuple[Array, ...]:
        a, b, c, d = factors
        before, at, after, beyond = taps
        return tuple(a * before[i] + b * at[i] + c * after[i] + d * beyond[i] for i in channels)

    return combine(weights), combine(derivatives)
