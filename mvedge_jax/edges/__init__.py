"""Multi-view edges: points, the surfaces that they belong to, depth edges (Thesis 4.1-4.3)."""

from ._bidirectional import (
    Bidirectional as Bidirectional,
    BidirectionalParams as BidirectionalParams,
    bidirectional as bidirectional,
    depth_edge_confidence as depth_edge_confidence,
)
from ._edges import (
    measured_edges as measured_edges,
    multiview_edges as multiview_edges,
)
from ._params import EdgeParams as EdgeParams, EdgeSizes as EdgeSizes
from ._points import EdgePoints as EdgePoints, Edges as Edges, EdgeStats as EdgeStats
from ._profile import step_response as step_response
from ._range import scene_range as scene_range
from ._raster import rasterise as rasterise, share as share
from ._surface import (
    SurfaceParams as SurfaceParams,
    SurfaceVectors as SurfaceVectors,
    choose as choose,
    surface_vectors as surface_vectors,
)
