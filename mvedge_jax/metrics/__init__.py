"""Scores: depth errors, what is said about them, boundaries, consistency, reprojection.

Rooms: `depth` (the single figures that `depth_scores` gathers), `superpixels` (Thesis 5.2.3).
"""

from mvedge_jax._export import register

from ._boundary import BoundaryScores as BoundaryScores, boundary_scores as boundary_scores
from ._calibration import Calibration as Calibration, calibration as calibration
from ._consistency import (
    ViewConsistency as ViewConsistency,
    view_consistency as view_consistency,
    view_consistency_map as view_consistency_map,
)
from ._region import edge_band as edge_band
from ._reprojection import Reprojection as Reprojection, reprojection_error as reprojection_error
from ._temporal import (
    TemporalConsistency as TemporalConsistency,
    temporal_consistency as temporal_consistency,
)
from .depth import DepthScores as DepthScores, depth_scores as depth_scores

register(__name__)
