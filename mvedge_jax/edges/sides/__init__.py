"""The surface that an edge belongs to (Thesis 4.2.2), and depth edges (4.3)."""

from ._bidirectional import (
    Bidirectional as Bidirectional,
    DirectionalDiffusion as DirectionalDiffusion,
    bidirectional as bidirectional,
    depth_edge_confidence as depth_edge_confidence,
)
from ._parts import (
    BidirectionalSides as BidirectionalSides,
    MapSides as MapSides,
    NoSides as NoSides,
    ReprojectionSides as ReprojectionSides,
    SideChoice as SideChoice,
    Sides as Sides,
    ThesisSides as ThesisSides,
)
from ._profile import step_response as step_response, thesis_response as thesis_response
from ._surface import (
    SideVote as SideVote,
    SurfaceVectors as SurfaceVectors,
    surface_vectors as surface_vectors,
)
