"""Multi-view edges and dense, occlusion-correct depth from light fields, in JAX.

The names that most programs need; each folder of the package exports the rest of its stage.
"""

from .datasets import load_light_field as load_light_field
from .diffusion import System as System, diffuse as diffuse
from .epi import EdgePoints as EdgePoints, multiview_edges as multiview_edges
from .lightfield import Camera as Camera, GroundTruth as GroundTruth, LightField as LightField
from .reconstruct import (
    DepthResult as DepthResult,
    Parameters as Parameters,
    Sizes as Sizes,
    edge_to_depth as edge_to_depth,
)
