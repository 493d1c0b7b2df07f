"""Depth of every view with progress, for `mvedge views`, `edit` and `superpixels`."""

import time

import jax

from mvedge_jax.all_views import ViewDepth, ViewDepths, depth_of_views
from mvedge_jax.depth import EdgeDepth, estimate_depth
from mvedge_jax.lightfield import LightField

from ._common import compiled, missing_views, stage


def every_view(light_field: LightField) -> tuple[ViewDepths, float, list[str]]:
    """Depth of every view of a light field, stage by stage.

    Args:
        light_field: without ground truth.

    Returns:
        The maps, the seconds from the centre view's map to all of them, and what speaks against
        them, one sentence each.
    """
    with stage("choosing sizes"):
        model = EdgeDepth.for_light_field(light_field)
        every = ViewDepth.for_light_field(light_field)
    with stage("compiling, or reading what was compiled before"):
        centre = compiled(estimate_depth, light_field, model)
    with stage("estimating depth of the centre view"):
        result = jax.block_until_ready(centre(light_field, model))
    with stage("compiling, or reading what was compiled before"):
        program = compiled(depth_of_views, light_field, result, every)
    start = time.perf_counter()
    with stage("estimating depth of all views"):
        found = jax.block_until_ready(program(light_field, result, every))
    seconds = time.perf_counter() - start
    doubts = [*result.problems(), *missing_views(light_field)]
    if int(found.overflow):
        doubts.append(f"{int(found.overflow)} hidden samples found no slot and were left out.")
    return found, seconds, doubts
