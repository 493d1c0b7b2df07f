"""Scores: depth errors, depth boundaries, consistency between views, reprojection."""

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
