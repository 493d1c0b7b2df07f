"""Where tiles lie."""

import math
from typing import NamedTuple

import numpy as np

from mvedge_jax._stored_views import StoredViews, Window

# Bytes that preset `full` takes on a CPU per pixel of a tile, and for all else: measured with 9x9
# views and 30 hypotheses, see `experiments/benchmarks/large.py`.
_PER_PIXEL, _LEAST = 3300, 0.8e9
# Bytes per pixel of the whole image: its center view in floating point, and the maps twice.
_WHOLE = 36


class Tile(NamedTuple):
    """A tile, and the part of the image that its depth counts for.

    Attributes:
        window: what is read.
        core: what is kept; the cores of all tiles are the image, without overlap.
    """

    window: Window
    core: Window


class Tiling(NamedTuple):
    """How an image is cut.

    Attributes:
        side: of a tile, px, at most: tiles are as small as their number allows, in steps of 16 px.
        overlap: that neighboring tiles share at least, px: of each of them, half is kept.

    Example:
        >>> tiles = Tiling(side=64, overlap=16).of(80, 48)
        >>> [(tile.window.top, tile.window.height, tile.core.top) for tile in tiles]
        [(0, 48, 0), (32, 48, 40)]
    """

    side: int = 768
    overlap: int = 96

    @staticmethod
    def within(memory: float, *, views: StoredViews | None = None, overlap: int = 96) -> "Tiling":
        """The largest tiles, in steps of 64 px, whose depth takes no more than some memory.

        Args:
            memory: bytes, that of Python and its libraries included; a ValueError if nothing fits.
            views: the views of the whole image, which count as well, with its maps.
            overlap: see `Tiling`.
        """
        least = _LEAST
        if views is not None:
            _, _, height, width = views.shape
            least += views.size + _WHOLE * height * width
        side = 64 * int(math.sqrt(max(memory - least, 0) / _PER_PIXEL) // 64)
        if side < 2 * overlap:
            need = (least + _PER_PIXEL * (2 * overlap) ** 2) / 1e9
            raise ValueError(
                f"`memory` must be at least {need:.2g} GB for tiles that overlap by {overlap} px, "
                f"got {memory / 1e9:.3g} GB."
            )
        return Tiling(side, overlap)

    def of(self, height: int, width: int) -> list[Tile]:
        """All tiles of an image of height and width, px, row by row; at least one, of one shape.

        A ValueError if tiles are not at least twice as long as they overlap.
        """
        if not 0 <= 2 * self.overlap <= self.side or self.side < 1:
            raise ValueError(
                "`side` must be positive and at least twice `overlap`, which must not be negative; "
                f"got {self.side} and {self.overlap} px."
            )
        rows, columns = self._along(height), self._along(width)
        return [
            Tile(
                Window(row.window[0], column.window[0], row.window[1], column.window[1]),
                Window(row.core[0], column.core[0], row.core[1], column.core[1]),
            )
            for row in rows
            for column in columns
        ]

    def _along(self, length: int) -> list["_Interval"]:
        """Starts and lengths along an axis."""
        side, count = min(self.side, length), 1
        if side < length:
            count = math.ceil((length - self.overlap) / (side - self.overlap))
            enough = math.ceil((length - self.overlap) / count) + self.overlap
            side = min(side, 16 * math.ceil(enough / 16))
        starts = np.round(np.linspace(0, length - side, count)).astype(int).tolist()
        cuts = [0, *((a + side + b) // 2 for a, b in zip(starts, starts[1:], strict=False)), length]
        return [
            _Interval((start, side), (first, last - first))
            for start, first, last in zip(starts, cuts, cuts[1:], strict=False)
        ]


class _Interval(NamedTuple):
    """Along an axis, start and length of what is read and of what is kept."""

    window: tuple[int, int]
    core: tuple[int, int]
