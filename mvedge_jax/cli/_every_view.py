"""Depth of every view with progress, for `mvedge views`, `edit` and `superpixels`."""

import time
from typing import NamedTuple

import jax

from mvedge_jax.all_views import ViewDepth, ViewDepths, depth_of_views
from mvedge_jax.depth import EdgeDepth, estimate_depth
from mvedge_jax.lightfield import LightField

from ._common import compiled, missing_views, stage
from ._model import FULL, ModelOptions


class EveryView(NamedTuple):
    """Depth of every view.

    Attributes:
        depths: the maps.
        model: model of the center view.
        seconds: time from the center view's map to all maps.
        doubts: problems of the maps, one sentence each.
    """

    depths: ViewDepths
    model: EdgeDepth
    seconds: float
    doubts: list[str]


def every_view(
    light_field: LightField, *, options: ModelOptions = FULL, seed: int = 0
) -> EveryView:
    """Depth of every view of a light field, stage by stage.

    Args:
        light_field: without ground truth.
        options: options of the model of the center view.
        seed: seed of the random search of preset thesis.

    Returns:
        The maps with their model, time and problems.
    """
    key = jax.random.key(seed)
    with stage("choosing sizes"):
        model, every = options.model(light_field), ViewDepth.for_light_field(light_field)
    with stage("compiling depth, or reading what was compiled before"):
        centre = compiled(estimate_depth, light_field, model, key=key)
    with stage("estimating depth of the centre view"):
        result = jax.block_until_ready(centre(light_field, model, key=key))
    with stage("compiling depth of all views, or reading what was compiled before"):
        program = compiled(depth_of_views, light_field, result, every)
    start = time.perf_counter()
    with stage("estimating depth of all views"):
        found = jax.block_until_ready(program(light_field, result, every))
    seconds = time.perf_counter() - start
    doubts = [*result.problems(), *missing_views(light_field)]
    if int(found.overflow):
        doubts.append(f"{int(found.overflow)} hidden samples found no slot and were left out.")
    return EveryView(found, model, seconds, doubts)
