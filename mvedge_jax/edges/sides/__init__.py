"""The surface that an edge belongs to (Thesis 4.2.2), and depth edges (4.3)."""

from ._bidirectional import (
    Bidirectional as Bidirectional,
    BidirectionalParams as BidirectionalParams,
    bidirectional as bidirectional,
    depth_edge_confidence as depth_edge_confidence,
)
from ._profile import step_response as step_response
from ._surface import (
    SurfaceParams as SurfaceParams,
    SurfaceVectors as SurfaceVectors,
    choose as choose,
    surface_vectors as surface_vectors,
)
