"""Multi-view edges and dense, occlusion-correct depth from light fields, in JAX.

The root exports the names that most programs need; each subpackage exports the rest of its stage.
Readers of files and the model's optimization are imported on first use, with their libraries:
OpenCV, h5py, SciPy, Optax.
"""

import typing as _typing
from importlib import import_module as _import_module

from ._batched import batched as batched
from ._cache import compilation_cache as compilation_cache
from ._compiler import lean_jit as lean_jit
from ._cpu import compiler_options as compiler_options
from ._export import register as _register
from ._paths import describe as describe
from .all_views import (
    ViewDepth as ViewDepth,
    ViewDepths as ViewDepths,
    depth_of_views as depth_of_views,
)
from .depth import (
    DepthResult as DepthResult,
    EdgeDepth as EdgeDepth,
    depth as depth,
    multiview_edges as multiview_edges,
)
from .diffusion import System as System, diffuse as diffuse
from .edges import EdgePoints as EdgePoints
from .lightfield import Camera as Camera, GroundTruth as GroundTruth, LightField as LightField

if _typing.TYPE_CHECKING:
    from . import (
        datasets as datasets,
        losses as losses,
        model as model,
        plotting as plotting,
        posed as posed,
    )
    from .datasets import load_light_field as load_light_field
    from .model import (
        Optimized as Optimized,
        Renderer as Renderer,
        Start as Start,
        SupervisedFit as SupervisedFit,
        fit_edges as fit_edges,
        optimize_edges as optimize_edges,
        start_from_depth as start_from_depth,
        start_from_image as start_from_image,
    )
    from .model.approaches import ByEvidence as ByEvidence, ByReprojection as ByReprojection
    from .model.optimization import Growth as Growth

_LATER = {
    "load_light_field": "datasets",
    "Optimized": "model",
    "Renderer": "model",
    "Start": "model",
    "SupervisedFit": "model",
    "fit_edges": "model",
    "optimize_edges": "model",
    "start_from_depth": "model",
    "start_from_image": "model",
    "ByEvidence": "model.approaches",
    "ByReprojection": "model.approaches",
    "Growth": "model.optimization",
}
_FOLDERS = ("datasets", "losses", "model", "plotting", "posed")

_register(__name__)


def __getattr__(name: str) -> _typing.Any:
    """`__version__` and lazily imported names."""
    if name == "__version__":
        from mvedge._version import package_version

        return package_version()
    if name in _FOLDERS:
        return _import_module(f".{name}", __name__)
    if name in _LATER:
        return getattr(_import_module(f".{_LATER[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER, *_FOLDERS})
