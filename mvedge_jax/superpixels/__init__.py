"""Superpixels: one label per surface patch in every view (Thesis Ch. 5)."""

from mvedge_jax._export import register

from ._clustering import SuperpixelClustering as SuperpixelClustering
from ._soft import (
    SoftSuperpixels as SoftSuperpixels,
    soft_superpixels as soft_superpixels,
    through_superpixels as through_superpixels,
)
from ._superpixels import Superpixels as Superpixels, superpixels as superpixels

register(__name__)
