"""Preparation of a scene: calibrated views, a first map, and splines for the measurement."""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax._checkpoint import checkpoint
from mvedge_jax._cpu import checkpoint_stage
from mvedge_jax._crosshair import Arm, Crosshair
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from .brightness._brightness import Brightness, NoiseModel
from .brightness._denoise import blur_of, denoised, low_pass, passed, soften
from .brightness._exposure import Exposure, expose
from .brightness._noise import Known, Noise, measure_noise
from .brightness._uncalibrated import Uncalibrated
from .matching._cost import Hypotheses, Matching, hypotheses
from .matching._unexplained import between_views_variance
from .measuring._crosshair import CrosshairSplines, NormalEquations
from .measuring._grid import ViewSplines
from .measuring._measure import PhotometricLabels, average_over_surface, labels
from .measuring._measuring import AdaptedMeasurement, Measurement
from .views import ViewSet, views_of


class CalibratedViews(NamedTuple):
    """Views without differences of exposure and gain, with their noise.

    Attributes:
        views: the crosshair of a light field, or photographs, after exposure and gains.
        exposure: the exposure and gains removed.
        noise: noise of these views, in their units.
        guide: the reference view, denoised, `[c, y, x]`.
        lab: the same in CIELAB.
        hypotheses: per pixel, the disparity at which the views agree best, and how ambiguous it is;
            None after `recenterd`.
        lit: 0 in and around the vignette mask or transparent pixels of the reference, 1 elsewhere;
            None for 1 everywhere.
    """

    views: Crosshair | ViewSet
    exposure: Exposure
    noise: Noise
    guide: Float[Array, "c y x"]
    lab: Float[Array, "c y x"]
    hypotheses: Hypotheses | None
    lit: Float[Array, "y x"] | None = None

    @property
    def first(self) -> Float[Array, "y x"] | None:
        """The first map; None after `recenterd`."""
        return None if self.hypotheses is None else self.hypotheses.disparity

    @property
    def arms(self) -> Crosshair:
        """The two arms of a light field."""
        if not isinstance(self.views, Crosshair):
            raise TypeError("`views` must be a crosshair to have arms, got photographs.")
        return self.views


class PreparedViews(NamedTuple):
    """Views prepared for the measurement.

    Attributes:
        splines: splines of the crosshair, or of photographs, low-passed according to the noise.
        params: parameters of the measurement in views of this noise.
        every: all views of a light field if labels are measured in them, else None.
    """

    splines: CrosshairSplines | ViewSplines
    params: AdaptedMeasurement
    every: ViewSplines | None = None

    def accumulate(self, disparity: Float[Array, "y x"]) -> NormalEquations:
        """Accumulates the normal equations around a map."""
        return self.splines.accumulate(disparity, self.params)


def hypothesis_count(span: float, steps: int) -> int:
    """Number of hypotheses, half a pixel apart in the outermost view.

    Args:
        span: width of the range, px per view step.
        steps: from the center view to the outermost one.

    Returns:
        The number, at least 2.
    """
    return max(math.ceil(2 * steps * span) + 1, 2)


def occluder_radius(span: float, steps: int, shape: tuple[int, int]) -> int:
    """Largest distance, px, of an occluder that hides a pixel in some view.

    Args:
        span: width of the range, px per view step.
        steps: from the center view to the outermost one.
        shape: of the views, px.

    Returns:
        Pixels, at least 1.
    """
    return max(1, min(math.ceil(steps * span), max(shape)))


_Searched = tuple[Exposure, Hypotheses]


def prepare(
    views: Uncalibrated,
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    window: int,
    brightness: Brightness | None = None,
    known: Known | None = None,
) -> CalibratedViews:
    """Measures exposure, gains and noise, and finds the first map.

    Gains and vignettes are measured twice: roughly, and again along the first map. If there are
    vignettes, the map is searched again, and both are measured once more.

    Args:
        views: `GridViews` of a light field, or `PosedViews`.
        disparities: hypotheses, px per view step, increasing, evenly spaced.
        params: parameters of the hypotheses.
        window: half the width of the hypotheses' windows, px.
        brightness: parameters of exposure, gains and noise; None for the defaults.
        known: exposure and noise, if they are not to be measured.

    Returns:
        The scene. Differentiable in views and parameters at the hypotheses chosen.
    """
    brightness = Brightness() if brightness is None else brightness
    if known is None:
        exposure = views.rough_exposure(brightness)
        own = views.exposed(exposure)
        between = between_views_variance(own, disparities, finer=brightness.noise.finer)
        noise = measure_noise(own.center, exposure.scale, between=between, params=brightness.noise)
    else:
        exposure, noise = known
        own = views.exposed(exposure)
    scene = _guided(own, exposure, noise, brightness.noise)

    @checkpoint_stage
    def searched(
        own: Crosshair | ViewSet, lab: Array, noise: Noise, params: Matching
    ) -> Hypotheses:
        sigma = jnp.clip(0.4 + 30 * noise.deviation, 0.5, 1.0)
        soft = own.mapped(lambda planes: soften(planes, noise, sigma))
        return hypotheses(soft, lab, disparities, params, noise=noise, window=window)

    def measured(state: _Searched) -> _Searched:
        here = _evened(scene, views, state[0])
        found = searched(here.views, here.lab, noise, params)
        return views.exposure_along(here.exposure.scale, found.disparity, brightness), found

    def again(state: _Searched, start: Array) -> tuple[_Searched, None]:
        return lax.cond(start | state[0].uneven, measured, lambda state: state, state), None

    if known is not None:
        found = searched(scene.views, scene.lab, noise, params)
    else:
        # A loop, so that the search is traced once; without vignettes the second one is skipped.
        nothing = jnp.zeros_like(scene.guide[0])
        start = exposure, Hypotheses(nothing, nothing, nothing)
        (exposure, found), _ = lax.scan(checkpoint(again), start, jnp.asarray([True, False]))
        scene = _evened(scene, views, exposure)
    return scene._replace(hypotheses=found, lit=views.lit(brightness))


def _evened(scene: CalibratedViews, views: Uncalibrated, exposure: Exposure) -> CalibratedViews:
    """The scene with another exposure; its guide is without the reference's vignette."""
    factor = exposure.factors(views.reference, scene.guide.shape[1:]) / exposure.scale
    guide = scene.guide * factor[None]
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(guide, 0, -1)), -1, 0)
    return scene._replace(views=views.exposed(exposure), exposure=exposure, guide=guide, lab=lab)


def prepare_views(
    scene: CalibratedViews, params: Measurement, *, every: LightField | None = None
) -> PreparedViews:
    """Low-passes the views according to their noise and adapts the measurement to it.

    Args:
        scene: see `prepare`.
        params: of the measurement in views without noise.
        every: the light field, to measure in all of its views.

    Returns:
        Views and parameters for `labels`. Differentiable.
    """
    soft, around = scene.views.mapped(low_pass(scene.noise)), None
    of = CrosshairSplines.of(soft) if isinstance(soft, Crosshair) else ViewSplines.of(soft)
    if every is not None:
        whole = views_of(expose(every, scene.exposure))
        around = ViewSplines.of(whole.mapped(low_pass(scene.noise)))
    return PreparedViews(of, adapted_measurement(scene.noise, scene.exposure.scale, params), around)


def adapted_measurement(
    noise: Noise, scale: Float[Array, ""], params: Measurement
) -> AdaptedMeasurement:
    """Parameters of a measurement in views of a given noise.

    Args:
        noise: noise of the views before their low-pass.
        scale: factor by which the views were brightened.
        params: of the measurement in views without noise.

    Returns:
        Parameters for `labels`. Differentiable.
    """
    plain, clear = cast(AdaptedMeasurement(), scale.dtype), 1 - noise.alpha
    kept, grain = passed(noise, blur_of(noise))
    changed: dict[str, Any] = {
        # Noise looks like drift and hides the colors of surfaces.
        "stiffness": plain.stiffness / clear**2,
        "same_color": params.same_color / clear,
        "noise": jnp.maximum(jnp.sqrt(kept) * noise.deviation, plain.noise),
        "rounding": scale * noise.rounding,
        # The mean gradients of all views have less noise than the residual.
        "gradient_noise": plain.gradient_noise * grain * (1 - 0.6 * noise.alpha**4),
    }
    return AdaptedMeasurement(**(vars(params) | changed))


def recenterd(
    light_field: LightField,
    view: Int[Array, "2"],
    exposure: Exposure,
    noise: Noise,
    *,
    params: NoiseModel | None = None,
) -> CalibratedViews:
    """The row and the column of views through any view, as the crosshair of a scene of its own.

    Args:
        light_field: the views as they came.
        view: index `(v, u)` of the new center view, traced.
        exposure: exposure of the light field.
        noise: noise of its views after exposure.
        params: parameters of the denoising of the guide; None for the defaults.

    Returns:
        The scene, without a first map; steps are relative to `view`. Differentiable.

    Example:
        >>> field = LightField(jnp.zeros((3, 5, 8, 8, 3)))
        >>> same = Exposure(jnp.ones(()), jnp.ones((3, 5)))
        >>> moved = recenterd(field, jnp.asarray([0, 4]), same, Noise.of(jnp.zeros(())))
        >>> sorted(moved.arms[0].steps.tolist())
        [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    v, u = view.astype(jnp.int32)
    shape = light_field.views.shape[2:4]

    def arm(views: Array, factors: Array, there: Array, own: Array, steps: Array) -> Arm:
        count = views.shape[0]
        # The reference is in the middle of an arm; the order of the other views does not matter.
        order = (jnp.arange(count, dtype=jnp.int32) - count // 2 + own) % count
        planes = jnp.moveaxis((views * factors[..., None])[order], -1, 1)
        return Arm(planes, (steps[order] - steps[own]).astype(views.dtype), there[order])

    views, there, steps = light_field.views, light_field.available, light_field.steps
    column = slice(None), u
    across = arm(views[v], exposure.factors(v, shape), there[v], u, steps[v, :, 0])
    down = arm(views[column], exposure.factors(column, shape), there[:, u], v, steps[:, u, 1])
    down = down._replace(planes=jnp.swapaxes(down.planes, -1, -2))
    return _guided(Crosshair(across, down), exposure, noise, params)


def _guided(
    views: Crosshair | ViewSet, exposure: Exposure, noise: Noise, params: NoiseModel | None
) -> CalibratedViews:
    """A scene without a first map, guided by the denoised reference view."""
    guide = denoised(views.center, noise, params=params)
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(guide, 0, -1)), -1, 0)
    return CalibratedViews(views, exposure, noise, guide, lab, None)


def first_labels(
    scene: CalibratedViews, prepared: PreparedViews
) -> tuple[PhotometricLabels, Float[Array, "s y x"]]:
    """Measures every pixel around the first map of a light field.

    Args:
        scene: a scene with a first map.
        prepared: its views.

    Returns:
        Labels, averaged over neighbors, and the weights of the views, see
        `CrosshairSplines.accumulate_with_weights`. Differentiable.

    Raises:
        ValueError: the scene has no first map, or is not that of a light field.
    """
    first, lab, params = scene.first, scene.lab, prepared.params
    if first is None:
        raise ValueError("`scene` has no first map; `prepare` finds one.")
    if not isinstance(prepared.splines, CrosshairSplines):
        raise ValueError("`prepared` must be views of a crosshair, got photographs.")
    found, weights = prepared.splines.accumulate_with_weights(first, params)
    measured = labels(found, lab, first, params, passes=params.passes)
    return average_over_surface(measured, lab, params, passes=params.passes), weights
