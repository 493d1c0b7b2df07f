"""Posed photographs from COLMAP models, `transforms.json`, trajectories and cameras by hand."""

from ._colmap_depth import read_colmap_depth as read_colmap_depth
from ._photographs import (
    load_photographs as load_photographs,
    open_photographs as open_photographs,
    with_points as with_points,
)
