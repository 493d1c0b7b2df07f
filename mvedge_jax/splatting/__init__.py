"""Splatting of points: super-Gaussian weights, transmittance compositing (thesis 7.1.2-7.1.3)."""

from ._labels import SplatLabels as SplatLabels
from ._profile import absorption as absorption
from ._raster import SplatRaster as SplatRaster, SplatWidths as SplatWidths
from ._splat import Splat as Splat, normalize as normalize, splat as splat
