"""Multi-view edges: points in the center view and their disparity (Thesis 4.1).

Subpackages: `sides` (the surface of an edge, and depth edges; Thesis 4.2.2, 4.3), `thesis` (points
    by the thesis' own steps).
"""

from ._edges import EdgeDetector as EdgeDetector, OrientedEdges as OrientedEdges
from ._points import EdgePoints as EdgePoints, Edges as Edges, EdgeStats as EdgeStats
from ._range import scene_range as scene_range
from ._raster import Raster as Raster, rasterize as rasterize, share as share
