"""What is found out about a scene before anything is measured in it."""

import dataclasses
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax._crosshair import Arm, crosshair
from mvedge_jax._fence import recomputed, staged
from mvedge_jax._params import cast
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from .brightness._brightness import Brightness, NoiseModel
from .brightness._denoise import denoised, low_pass, soften
from .brightness._exposure import Exposure, expose, exposed_arms, exposure_along, rough_exposure
from .brightness._noise import Noise, measure_noise
from .brightness._unlit import lit
from .matching._cost import Matching, hypotheses
from .measuring._grid import Grid, grid_of
from .measuring._look import ArmSplines, Look, arm_splines, look, look_with_weights
from .measuring._measure import PhotometricLabels, labels, shared
from .measuring._measuring import Measurement, Measuring


class CalibratedViews(NamedTuple):
    """The crosshair of a light field whose brightness and noise are known.

    Attributes:
        arms: horizontal and vertical, exposure and gains taken out.
        exposure: what was taken out.
        noise: of the views, in their units now.
        guide: the centre view, denoised, `[c, y, x]`.
        lab: the same in CIELAB.
        first: per pixel, the disparity at which the views agree best; None after `recentred`.
        lit: 0 where the lens leaves the views dark, and around it, 1 elsewhere; None after
            `recentred`.
    """

    arms: tuple[Arm, Arm]
    exposure: Exposure
    noise: Noise
    guide: Float[Array, "c y x"]
    lab: Float[Array, "c y x"]
    first: Float[Array, "y x"] | None
    lit: Float[Array, "y x"] | None = None

    @property
    def centre(self) -> Float[Array, "c y x"]:
        """The centre view, exposure taken out."""
        return self.arms[0].planes[self.arms[0].centre]


class PreparedViews(NamedTuple):
    """Views made ready for being measured in.

    Attributes:
        arms: of the crosshair, low-passed as the noise asks.
        splines: the same as coefficients of cubic splines.
        params: of the measurement in views of this noise.
        grid: all views, where they are asked for.
    """

    arms: tuple[Arm, Arm]
    splines: tuple[ArmSplines, ArmSplines]
    params: Measuring
    grid: Grid | None = None

    def look(self, disparity: Float[Array, "y x"]) -> Look:
        """Reads the views of the crosshair around a map, see `look`."""
        return look(*self.splines, disparity, self.params, radius=self.params.radius)


def hypothesis_count(span: float, steps: int) -> int:
    """Disparities to try: neighbours differ by half a pixel in the outermost view.

    Args:
        span: width of the range, px per view step.
        steps: from the centre view to the outermost one.

    Returns:
        Their number, at least 2.
    """
    return max(math.ceil(2 * steps * span) + 1, 2)


def occluder_radius(span: float, steps: int, shape: tuple[int, int]) -> int:
    """How far away an occluder can be that is over a pixel in some view, px.

    Args:
        span: width of the range, px per view step.
        steps: from the centre view to the outermost one.
        shape: of the views, px.

    Returns:
        Pixels, at least 1.
    """
    return max(1, min(math.ceil(steps * span), max(shape)))


def prepare(
    light_field: LightField,
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    window: int,
    every: bool = False,
    brightness: Brightness | None = None,
) -> CalibratedViews:
    """Measures exposure, gains and noise, and finds the first map.

    Gains and vignettes are measured twice: roughly, and again along the first map, when it is known
    what shows the same. If there are vignettes, the map is searched, and both are measured, again.

    Args:
        light_field: the crosshair of views is read.
        disparities: what to try, px per view step, increasing, evenly spaced.
        params: of the hypotheses.
        window: half the width of their windows, px.
        every: measure the gains of all views along it, not of the crosshair alone.
        brightness: how exposure, gains and noise are found; None for the defaults.

    Returns:
        The scene. Differentiable in views and parameters at the hypotheses chosen.
    """
    own = crosshair(light_field)
    brightness = Brightness() if brightness is None else brightness
    exposure = rough_exposure(light_field, params=brightness)
    arms = exposed_arms(own, exposure)
    centre = arms[0].planes[arms[0].centre]
    noise = measure_noise(
        centre, exposure.scale, arms=arms, disparities=disparities, params=brightness.noise
    )
    scene = _guided(arms, exposure, noise, brightness.noise)

    @staged
    def searched(
        arms: tuple[Arm, Arm], lab: Array, noise: Noise, params: Matching
    ) -> Float[Array, "y x"]:
        sigma = jnp.clip(0.4 + 30 * noise.deviation, 0.5, 1.0)
        soft = low_pass(arms, noise, sigma).arms
        return hypotheses(*soft, lab, disparities, params, noise=noise, window=window)

    def measured(state: tuple[Exposure, Array]) -> tuple[Exposure, Array]:
        here = _evened(scene, own, state[0])
        first = searched(here.arms, here.lab, noise, params)
        scale = here.exposure.scale
        return exposure_along(light_field, scale, first, every=every, params=brightness), first

    def again(state: tuple[Exposure, Array], start: Array) -> tuple[tuple[Exposure, Array], None]:
        return lax.cond(start | state[0].uneven, measured, lambda state: state, state), None

    # A loop, so that the search is traced once; without vignettes it is left out the second time.
    start = exposure, jnp.zeros_like(scene.guide[0])
    (exposure, first), _ = lax.scan(recomputed(again), start, jnp.asarray([True, False]))
    return _evened(scene, own, exposure)._replace(first=first, lit=lit(own, brightness))


def _evened(scene: CalibratedViews, own: tuple[Arm, Arm], exposure: Exposure) -> CalibratedViews:
    """The scene after another exposure, the vignette of the centre view taken out of its guide."""
    centre = own[1].centre, own[0].centre
    factor = exposure.factors(centre, scene.guide.shape[1:]) / exposure.scale
    guide = scene.guide * factor[None]
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(guide, 0, -1)), -1, 0)
    return scene._replace(arms=exposed_arms(own, exposure), exposure=exposure, guide=guide, lab=lab)


def prepare_views(
    scene: CalibratedViews, params: Measurement, *, every: LightField | None = None
) -> PreparedViews:
    """Low-passes the views as far as their noise asks, and says what that does to measurements.

    Args:
        scene: see `prepare`.
        params: of the measurement in views without noise.
        every: the light field, if all of its views are to be measured in.

    Returns:
        Views and parameters for `look` and `labels`. Differentiable.
    """
    sigma = jnp.minimum(30 * scene.noise.deviation, 1)
    arms, kept, grain = low_pass(scene.arms, scene.noise, sigma)
    measuring = measuring_in(scene.noise, scene.exposure.scale, kept, grain, params)
    horizontal, vertical = map(arm_splines, arms)
    grid = None if every is None else _whole_grid(scene, every, sigma)
    return PreparedViews(arms, (horizontal, vertical), measuring, grid)


def measuring_in(
    noise: Noise,
    scale: Float[Array, ""],
    kept: Float[Array, ""],
    grain: Float[Array, ""],
    params: Measurement,
) -> Measuring:
    """What a measurement takes for granted in views that `soften` has blurred.

    Args:
        noise: of the views, before.
        scale: what they were brightened by.
        kept: of the noise, see `passed`.
        grain: of the noise, see `passed`.
        params: of the measurement in views without noise.

    Returns:
        Parameters for `look` and `labels`. Differentiable.
    """
    plain, clear = cast(Measuring(), scale.dtype), 1 - noise.alpha
    own: dict[str, Any] = {
        field.name: getattr(params, field.name) for field in dataclasses.fields(Measurement)
    }
    changed: dict[str, Any] = {
        # Drift cannot be told from noise, nor surfaces by their colours.
        "stiffness": plain.stiffness / clear**2,
        "same_colour": params.same_colour / clear,
        "noise": jnp.maximum(jnp.sqrt(kept) * noise.deviation, plain.noise),
        "rounding": scale * noise.rounding,
        # What noise is left in the mean gradients of all views is less than the residual says.
        "gradient_noise": plain.gradient_noise * grain * (1 - 0.6 * noise.alpha**4),
    }
    return Measuring(**(own | changed))


def _whole_grid(scene: CalibratedViews, every: LightField, sigma: Float[Array, ""]) -> Grid:
    """All views as `prepare_views` has those of the crosshair."""
    even = expose(every, scene.exposure).views
    planes = jnp.moveaxis(even.reshape(-1, *even.shape[2:]), -1, 1)
    soft = soften(planes, scene.noise, sigma)
    return grid_of(soft, every.steps.reshape(-1, 2), every.available.reshape(-1))


def recentred(
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
        view: index `(v, u)` of what becomes the centre view, traced.
        exposure: of the light field.
        noise: of its views, exposure taken out.
        params: how noise is taken out of the guide; None for the defaults.

    Returns:
        The scene, without a first map; steps are those from the view. Differentiable.

    Example:
        >>> field = LightField(jnp.zeros((3, 5, 8, 8, 3)))
        >>> same = Exposure(jnp.ones(()), jnp.ones((3, 5)))
        >>> moved = recentred(field, jnp.asarray([0, 4]), same, Noise.of(jnp.zeros(())))
        >>> sorted(moved.arms[0].steps.tolist())
        [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    v, u = view.astype(jnp.int32)
    shape = light_field.views.shape[2:4]

    def arm(views: Array, factors: Array, there: Array, own: Array, at: Array | None) -> Arm:
        count = views.shape[0]
        # An arm has its centre in the middle; the order of the other views does not matter.
        order = (jnp.arange(count, dtype=jnp.int32) - count // 2 + own) % count
        planes = jnp.moveaxis((views * factors[..., None])[order], -1, 1)
        steps = own - order if at is None else at[own] - at[order]
        return Arm(planes, steps.astype(views.dtype), there[order])

    places, there = light_field.positions, light_field.available
    columns, rows = (None, None) if places is None else (places[v, :, 0], places[:, u, 1])
    column = slice(None), u
    across = arm(light_field.views[v], exposure.factors(v, shape), there[v], u, columns)
    down = arm(light_field.views[column], exposure.factors(column, shape), there[:, u], v, rows)
    down = down._replace(planes=jnp.swapaxes(down.planes, -1, -2))
    return _guided((across, down), exposure, noise, params)


def _guided(
    arms: tuple[Arm, Arm], exposure: Exposure, noise: Noise, params: NoiseModel | None
) -> CalibratedViews:
    """A scene without a first map, whose guide is the centre view without its noise."""
    guide = denoised(arms[0].planes[arms[0].centre], noise, params=params)
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(guide, 0, -1)), -1, 0)
    return CalibratedViews(arms, exposure, noise, guide, lab, None)


def first_labels(
    scene: CalibratedViews, seen: PreparedViews
) -> tuple[PhotometricLabels, Float[Array, "s y x"]]:
    """Measures every pixel around the first map.

    Args:
        scene: with a first map.
        seen: its views.

    Returns:
        Labels, shared between neighbours, and the weights of the views, see `look_with_weights`.
        Differentiable.

    Raises:
        ValueError: the scene has no first map.
    """
    first, lab, passes = scene.first, scene.lab, seen.params.passes
    if first is None:
        raise ValueError("`scene` has no first map; `prepare` finds one.")
    found, weights = look_with_weights(*seen.splines, first, seen.params, radius=seen.params.radius)
    measured = labels(found, lab, first, seen.params, passes=passes)
    return shared(measured, lab, seen.params, passes=passes), weights
