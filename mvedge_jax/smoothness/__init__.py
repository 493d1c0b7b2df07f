"""Smoothness between neighboring pixels: edge weights of the diffusion (Thesis 6.1).

A smoothness is any callable `(guide, disparity, depth_edge) -> (tx, ty)`: see `Smoothness`.
"""

from ._color_and_depth import (
    ColorAndDepth as ColorAndDepth,
    edge_smoothness as edge_smoothness,
)
from ._protocol import Smoothness as Smoothness
from ._thesis import (
    ImageGradient as ImageGradient,
    PerPixel as PerPixel,
    ThesisSmoothness as ThesisSmoothness,
    image_roughness as image_roughness,
)
