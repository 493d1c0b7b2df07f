"""The differentiable model of multi-view edges, and its optimization (Thesis 7).

Subpackages: `objectives` (losses), `optimization` (the loop, its state, growing points),
`approaches` (losses from the views: by evidence, by reprojection).
"""

from mvedge_jax._export import register

from ._model import DepthModel as DepthModel, Renderer as Renderer, render_model as render_model
from ._optimize import (
    SupervisedFit as SupervisedFit,
    fit_edges as fit_edges,
    optimize_edges as optimize_edges,
)
from ._result import Optimized as Optimized
from ._start import (
    Start as Start,
    StartFit as StartFit,
    start_from_depth as start_from_depth,
    start_from_edges as start_from_edges,
    start_from_image as start_from_image,
)

register(__name__)
