"""Surface vectors and depth-edge confidence (Thesis 4.2.2, 4.3)."""

from ._bidirectional import (
    Bidirectional as Bidirectional,
    BidirectionalParams as BidirectionalParams,
    bidirectional as bidirectional,
    depth_edge_confidence as depth_edge_confidence,
    image_smoothness as image_smoothness,
    point_weight as point_weight,
)
from ._evidence import map_evidence as map_evidence, neighbour_evidence as neighbour_evidence
from ._profile import profiles as profiles, step_response as step_response
from ._raster import Raster as Raster, rasterise as rasterise, share as share
from ._reprojection import reprojection_score as reprojection_score
from ._surface import (
    Side as Side,
    SurfaceParams as SurfaceParams,
    SurfaceVectors as SurfaceVectors,
    along_edge as along_edge,
    choose as choose,
    surface_vectors as surface_vectors,
)
