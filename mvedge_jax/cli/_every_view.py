"""Depth of every view with progress, for `mvedge views`, `edit` and `superpixels`."""

from typing import NamedTuple

import jax

from mvedge_jax.all_views import ViewDepth, ViewDepths, depth_of_views
from mvedge_jax.depth import EdgeDepth, estimate_depth
from mvedge_jax.lightfield import LightField

from ._common import missing_views, run, stage
from ._model import FULL, ModelOptions


class EveryView(NamedTuple):
    """Depth of every view, the center view's model, seconds for the other maps, and problems."""

    depths: ViewDepths
    model: EdgeDepth
    seconds: float
    doubts: list[str]


def every_view(
    light_field: LightField, *, options: ModelOptions = FULL, seed: int = 0
) -> EveryView:
    """Depth of every view of a light field without ground truth, stage by stage."""
    key = jax.random.key(seed)
    with stage("choosing sizes"):
        model, every = options.model(light_field), ViewDepth.for_light_field(light_field)
    doing = "estimating depth of the center view"
    result, _ = run("depth", doing, estimate_depth, light_field, model, key=key)
    what, doing = "depth of all views", "estimating depth of all views"
    found, spent = run(what, doing, depth_of_views, light_field, result, every)
    doubts = [*result.problems(), *missing_views(light_field)]
    if int(found.overflow):
        doubts.append(f"{int(found.overflow)} hidden samples found no slot and were left out.")
    return EveryView(found, model, spent["estimation"], doubts)
