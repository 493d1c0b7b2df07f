"""Splatting of points: super-Gaussian weights, transmittance compositing (thesis 7.1.2-7.1.3)."""

from ._labels import SplatLabels as SplatLabels
from ._params import SplatParams as SplatParams, SplatSizes as SplatSizes
from ._profile import absorption as absorption, super_gaussian as super_gaussian
from ._reference import splat_reference as splat_reference
from ._splat import Splat as Splat, normalise as normalise, splat as splat
