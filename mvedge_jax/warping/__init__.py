"""Reprojection between views (Thesis 7.1.4)."""

from ._backward import backward_warp as backward_warp
from ._forward import (
    ForwardWarp as ForwardWarp,
    forward_warp as forward_warp,
    landing as landing,
    z_buffer as z_buffer,
)
from ._holes import Holes as Holes, holes as holes
from ._outline import Outline as Outline, outline as outline
from ._planes import warp_planes as warp_planes
from ._visibility import visible as visible, visible_binned as visible_binned
