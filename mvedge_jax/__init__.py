"""Multi-view edges and dense, occlusion-correct depth from light fields, in JAX.

The names that most programs need; each folder of the package exports the rest of its stage.
"""

from typing import Any as _Any

from ._cache import compilation_cache as compilation_cache
from ._compiler import compiler_options as compiler_options, lean_jit as lean_jit
from ._export import register as _register
from ._paths import describe as describe
from .all_views import (
    ViewDepth as ViewDepth,
    ViewDepths as ViewDepths,
    depth_of_views as depth_of_views,
)
from .datasets import load_light_field as load_light_field
from .depth import (
    DepthResult as DepthResult,
    EdgeDepth as EdgeDepth,
    depth as depth,
    multiview_edges as multiview_edges,
)
from .diffusion import System as System, diffuse as diffuse
from .edges import EdgePoints as EdgePoints
from .lightfield import Camera as Camera, GroundTruth as GroundTruth, LightField as LightField
from .model import (
    Optimised as Optimised,
    Renderer as Renderer,
    Start as Start,
    SupervisedFit as SupervisedFit,
    fit_edges as fit_edges,
    optimize_edges as optimize_edges,
    start_from_depth as start_from_depth,
    start_from_image as start_from_image,
)
from .model.approaches import ByEvidence as ByEvidence, ByReprojection as ByReprojection
from .model.optimisation import Growth as Growth

_register(__name__)


def __getattr__(name: str) -> _Any:
    """`__version__` and `plotting`, which need not cost every import its time."""
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name == "plotting":
        from importlib import import_module

        return import_module(".plotting", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
