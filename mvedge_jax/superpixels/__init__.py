"""Superpixels: one label per surface patch in every view (Thesis Ch. 5)."""

from ._parameters import SuperpixelParams as SuperpixelParams, SuperpixelSizes as SuperpixelSizes
from ._superpixels import Superpixels as Superpixels, superpixels as superpixels
