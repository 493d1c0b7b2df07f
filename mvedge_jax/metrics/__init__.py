"""Scores: depth errors, what is said about them, boundaries, consistency, superpixels."""

from ._boundary import BoundaryScores as BoundaryScores, boundary_scores as boundary_scores
from ._calibration import Calibration as Calibration, calibration as calibration
from ._consistency import (
    ViewConsistency as ViewConsistency,
    view_consistency as view_consistency,
    view_consistency_map as view_consistency_map,
)
from ._depth import (
    DepthScores as DepthScores,
    bad_pixels as bad_pixels,
    depth_scores as depth_scores,
    error_percentile as error_percentile,
    mae as mae,
    mse as mse,
    q25 as q25,
)
from ._region import edge_band as edge_band
from ._reprojection import Reprojection as Reprojection, reprojection_error as reprojection_error
from ._superpixels import (
    SuperpixelScores as SuperpixelScores,
    labels_per_pixel as labels_per_pixel,
    superpixel_scores as superpixel_scores,
)
