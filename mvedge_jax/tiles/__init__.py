"""Depth of images that are larger than the memory allows: tile by tile."""

from mvedge_jax._export import register
from mvedge_jax._stored_views import StoredViews as StoredViews, Window as Window

from ._depth import depth_in_tiles as depth_in_tiles, with_measured_range as with_measured_range
from ._layout import Tile as Tile, Tiling as Tiling

register(__name__)
