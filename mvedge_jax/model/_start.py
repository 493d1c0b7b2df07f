"""The start of the optimization: a model that renders the map of the edges."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy, cast, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.depth import DepthResult
from mvedge_jax.image import nearest_pixels
from mvedge_jax.lightfield import LightField
from mvedge_jax.smoothness import image_roughness

from ._host import compiled_render
from ._model import DepthModel, Renderer, map_roughness, with_capacity
from .objectives import Supervised, Trust, unlimited
from .optimization._grow import Growth, grow
from .optimization._optimize import advance
from .optimization._routine import Rates, all_at_once
from .optimization._state import begin

# Roughness per slope of the lightness, px/L*.
_ROUGHNESS = 0.3


class StartFit(eqx.Module):
    """Parameters of a model from points and a first map.

    Attributes:
        agreement: largest difference between point and map, px; beyond, a point takes the map's
            disparity.
        reference_error: standard error at which a point has the weight 1, px.
        offset: added to Q; positive values trust labels more than smoothness.
        rates: of the fit to the map: Q, Z, R, xy.
    """

    agreement: Float[Array, ""] = number(0.05)
    reference_error: Float[Array, ""] = number(0.005)
    offset: Float[Array, ""] = number(0.0)
    rates: Float[Array, "4"] = number((0.15, 0.004, 0.08, 0.02))


class Start(NamedTuple):
    """A model, the errors of its labels, and the map that it represents.

    Attributes:
        model: the parameters.
        error: standard error of each label, px per view step; infinite if unknown.
        disparity: a map near the one that `model` renders, px per view step.
    """

    model: DepthModel
    error: Float[Array, "n"]
    disparity: Float[Array, "y x"]


def start_from_depth(
    light_field: LightField, depth: DepthResult, *, fit: StartFit | None = None
) -> Start:
    """Makes a model from a result of `EdgeDepth`, with any preset.

    Args:
        light_field: the light field of the result.
        depth: result of `EdgeDepth`.
        fit: see `StartFit`; None for the defaults.

    Returns:
        The model, from points on their surfaces and the steps of the map, see
        `start_from_points`. Differentiable in the views, the map, labels and positions.
    """
    points = depth.points
    return start_from_points(
        points.xy + depth.surface.offset,
        points.disparity,
        points.error,
        points.valid,
        light_field.center_view,
        depth.disparity,
        StartFit() if fit is None else fit,
    )


def start_from_edges(light_field: LightField, depth: DepthResult, renderer: Renderer) -> Start:
    """The start of the thesis: edge points of weight 1, and no dense map.

    Args:
        light_field: the light field of the result.
        depth: result of `EdgeDepth`; its points on their surfaces are read, its map is not.
        renderer: renders the first map.

    Returns:
        The model, with Q from the image gradient, and the map that it renders. The errors of its
        labels are unknown. On the host; the map is not differentiable.

    Source: Thesis 7.1.5.
    """
    points, center = depth.points, light_field.center_view
    there = nearest_pixels(points.xy + depth.surface.offset, (center.shape[0], center.shape[1]))
    valid = points.valid & there.inside
    place = jnp.where(valid[:, None], points.xy + depth.surface.offset, 0)
    label, nothing = jnp.where(valid, points.disparity, 0), jnp.zeros_like(center[..., 0])
    model = DepthModel(label, place, jnp.zeros_like(label), nothing, valid)
    start = start_from_image(Start(model, jnp.full_like(label, jnp.inf), nothing), center)
    return start._replace(disparity=compiled_render(start.model, renderer).disparity)


@accepts_numpy
def start_from_image(start: Start, center: Float[Array, "y x c"]) -> Start:
    """The smoothness of the thesis' start: Q from the image gradient instead of a map's steps.

    Args:
        start: a model.
        center: the center view, sRGB.

    Returns:
        The model with the new Q. Differentiable in the view.

    Source: Thesis 7.1.5.
    """
    lightness = srgb_to_lab(center)[..., 0]
    rough = image_roughness(lightness, jnp.asarray(_ROUGHNESS, center.dtype))
    return start._replace(model=eqx.tree_at(lambda m: m.roughness, start.model, rough))


def start_from_points(
    xy: Float[Array, "n 2"],
    disparity: Float[Array, "n"],
    error: Float[Array, "n"],
    valid: Bool[Array, "n"],
    center: Float[Array, "y x c"],
    first: Float[Array, "y x"],
    fit: StartFit,
) -> Start:
    """Makes a model from edge points on their surfaces and a first dense map.

    Weights follow from standard errors, smoothness from the steps of map and image. Points outside
    the image take no part.
    """
    dtype = center.dtype
    fit = cast(fit, dtype)
    at = nearest_pixels(xy, (first.shape[0], first.shape[1]))
    there = first[at.row, at.column]
    valid = valid & at.inside
    agrees = jnp.abs(disparity - there) <= fit.agreement
    label = jnp.where(agrees, disparity, there)
    error = jnp.where(agrees, error, 2 * fit.reference_error)
    rough = map_roughness(first, center) + fit.offset
    weight = jnp.clip(jnp.log(jnp.maximum(error, 1e-4) / fit.reference_error), -1, 3)
    clean = [jnp.where(valid, part, 0).astype(dtype) for part in (label, weight)]
    places = jnp.where(valid[:, None], xy, 0).astype(dtype)
    model = DepthModel(clean[0], places, clean[1], rough.astype(dtype), valid)
    return Start(model, jnp.where(valid, error, 1).astype(dtype), first.astype(dtype))


def fit_to_map(
    start: Start,
    fit: StartFit,
    renderer: Renderer,
    *,
    iterations: int = 6,
    extra: int | None = None,
) -> Start:
    """Fits a model to its own map, so that the optimization starts with the quality of that map.

    Adam on all parameters; in the middle of its `iterations`, `extra` points, by default a tenth of
    the points, are added at the largest errors. Their standard error is infinite.
    """
    first, n = start.disparity, start.model.valid.size
    extra = int(jnp.sum(start.model.valid)) // 10 if extra is None else extra
    model = with_capacity(start.model, n + extra)
    error = jnp.pad(start.error, (0, extra), constant_values=jnp.inf)
    limits = eqx.tree_at(lambda t: t.position, unlimited(model), jnp.asarray(1.0))
    known = jnp.ones(first.shape, bool)
    goal = Supervised(first, known, limits, renderer)
    routine = all_at_once(Rates(rate=fit.rates), iterations=iterations)
    state = begin(model, first, key=jax.random.key(0))
    half = iterations // 2
    state, _ = advance(state, routine.part(0, half), goal)
    if extra:
        wrong = jnp.abs(state.disparity - first)
        grown = grow(state, goal, wrong, first, Growth(), count=extra)
        replaced = grown.state.model.xy != state.model.xy
        error = jnp.where(jnp.any(replaced, axis=1), jnp.inf, error)
        state, goal = grown.state, grown.objective
        assert isinstance(goal, Supervised)
    state, _ = advance(state, routine.part(half, iterations), goal)
    return Start(state.best, error, first)


def trust_labels(
    start: Start,
    *,
    weight: Float[Array, ""] | float = 1e-3,
    label: Float[Array, ""] | float = 0.05,
    position: Float[Array, ""] | float = 1.0,
) -> Trust:
    """Prior of a `weight`, and limits of changes of labels and positions, px, for a start.

    Labels of infinite error have limits, but no prior.
    """
    one = start.model.disparity.dtype
    weight, label, position = (jnp.asarray(v).astype(one) for v in (weight, label, position))
    return Trust(start.model, start.error, weight, label, position)
