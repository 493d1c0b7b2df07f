"""Multi-view edges: points in the centre view and their disparity (Thesis 4.1).

Room: `sides` (which surface an edge belongs to, and depth edges; Thesis 4.2.2, 4.3).
"""

from ._edges import (
    measured_edges as measured_edges,
    multiview_edges as multiview_edges,
)
from ._params import EdgeParams as EdgeParams, EdgeSizes as EdgeSizes
from ._points import EdgePoints as EdgePoints, Edges as Edges, EdgeStats as EdgeStats
from ._range import scene_range as scene_range
from ._raster import rasterise as rasterise, share as share
