"""Disparity of every view, drawn from one set of surface samples (Thesis 6.1)."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int, Int8

from mvedge_jax._checkpoint import checkpoint
from mvedge_jax._checks import check_finite, checked_jit, expect, with_numbers
from mvedge_jax._params import cast
from mvedge_jax._root import safe_sqrt
from mvedge_jax.depth import DepthResult
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.brightness import GridViews

from ._draw import decided, drawn
from ._model import ViewDepth
from ._reference import uncovered
from ._samples import FILLED, SEEN, UNCOVERED, samples_of


class ViewDepths(NamedTuple):
    """Depth of every view.

    Attributes:
        disparity: px per view step, larger is nearer, `[v, u, y, x]`.
        error: standard error of the disparity, px, `[v, u, y, x]`. In holes it includes the
            difference of the surfaces around.
        source: source of each pixel, `[v, u, y, x]`: 0, visible in the center view; 1, in other
            views only; 2, in none, and continued from the surface behind.
        overflow: number of samples of other views without a slot (`ViewDepth.capacity`).
    """

    disparity: Float[Array, "v u y x"]
    error: Float[Array, "v u y x"]
    source: Int8[Array, "v u y x"]
    overflow: Int[Array, ""]


def _validate(light_field: Any, result: Any, model: Any) -> tuple[Any, ...]:
    """Validates the arguments of `depth_of_views`."""
    order = "the order is (light_field, result, model)"
    expect("light_field", light_field, LightField, order)
    check_finite(light_field.views)
    expect("result", result, DepthResult, "`depth` makes one, and " + order)
    made = "`ViewDepth.for_light_field(light_field)` makes one, and " + order
    expect("model", model, ViewDepth, made)
    return (light_field.bare(), result, with_numbers(model)), {}


@checked_jit(_validate)
def depth_of_views(light_field: LightField, result: DepthResult, model: ViewDepth) -> ViewDepths:
    """Estimates the disparity of every pixel of every view.

    1. The pixels of the center view are surface samples. In each corner view in turn, pixels that
       no sample explains are measured in the row and the column of views through it, and added.
    2. Every view is drawn from all samples: the nearest wins, a remaining hole continues the
       surface behind it, and the view's own colors decide on which side of a depth step the pixels
       beside it are.

    The maps agree by construction. The center view keeps its own map.

    Args:
        light_field: all available views are read; ground truth is not.
        result: result of `depth` for this light field.
        model: see `ViewDepth.for_light_field`.

    Returns:
        Maps of all views, missing ones included. Differentiable, forwards and backwards, in the
        views, in the disparity of `result` and in every array of `model`; which sample a pixel
        shows is a selection.

    Raises:
        ValueError: the map of `result` has another size than the views; outside `jit`, a number of
            `model` is not finite or is negative.
        TypeError: an argument is of another kind, or their order is another.

    Source: Thesis 6.1, whose angular diffusion (6.4)-(6.8) this replaces.
    """
    rows, columns, height, width = light_field.views.shape[:4]
    if result.disparity.shape != (height, width):
        raise ValueError(
            f"`result.disparity` must have the size of the views, {height}x{width}, got "
            f"{result.disparity.shape}."
        )
    model = cast(model, light_field.views.dtype)
    # Infinite errors of unknown pixels would give NaN derivatives.
    error = jnp.where(
        jnp.isfinite(result.error), result.error, safe_sqrt(jnp.var(result.disparity))
    )
    samples = samples_of(result.disparity, error, capacity=model.capacity)
    exposure = result.stats.exposure
    exposure = GridViews(light_field, every=True).exposure_along(
        exposure.scale, result.disparity, model.brightness, uneven=exposure.uneven
    )
    samples, count = uncovered(samples, light_field, exposure, result.stats.noise, model)

    def view(item: tuple[Array, ...]) -> tuple[Array, Array, Array]:
        picture, there, step = item
        first = drawn(samples, step, (height, width))
        planes = jnp.moveaxis(picture, -1, 0)
        drawing = decided(first, samples, planes, result.stats.noise.deviation, model.outline)
        index = jnp.where(there, drawing.sample, first.sample)
        source = jnp.where(samples.uncovered[index], UNCOVERED, SEEN)
        source = jnp.where(drawing.hole, FILLED, source).astype(jnp.int8)
        return samples.disparity[index], samples.error[index] + drawing.spread, source

    grid = rows * columns
    pictures = light_field.views.reshape(grid, height, width, -1)
    items = (pictures, light_field.available.ravel(), light_field.steps.reshape(grid, 2))
    maps = lax.map(checkpoint(view), items)
    own = (result.disparity, error, jnp.full((height, width), SEEN, jnp.int8))
    middle = grid // 2
    maps = [m.at[middle].set(o) for m, o in zip(maps, own, strict=True)]
    overflow = jnp.maximum(count - model.capacity, 0)
    disparity, error, source = (m.reshape(rows, columns, height, width) for m in maps)
    return ViewDepths(disparity, error, source, overflow)
