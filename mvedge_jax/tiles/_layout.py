"""Where tiles lie."""

import math
from typing import NamedTuple

from mvedge_jax._stored_views import StoredViews, Window

# Bytes that preset `full` takes on a CPU per pixel of a tile, and for all else: measured with 9x9
# views and 30 hypotheses, see `experiments/benchmarks/large.py`.
_PER_PIXEL, _LEAST = 2700, 0.8e9
# Tiles start at multiples of this, px, so that networks which halve the resolution see what they
# would in the whole image.
_STEP = 4
# Bytes per pixel of the whole image: prepared views, labels, guide and maps; and what the diffusion
# takes besides.
_WHOLE, _DIFFUSED = 340, 260


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
        side: of a tile, px, at most: tiles are as small as their number allows.
        overlap: that neighboring tiles share at least, px: of each of them, half is kept.

    Example:
        >>> tiles = Tiling(side=64, overlap=16).of(80, 48)
        >>> [(tile.window.top, tile.window.height, tile.core.top) for tile in tiles]
        [(0, 52, 0), (28, 52, 40)]
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
        pixels = 0 if views is None else views.shape[2] * views.shape[3]
        least = _LEAST + (0 if views is None else views.size)
        room = memory - least - _WHOLE * pixels
        side = 64 * int(math.sqrt(max(room, 0) / _PER_PIXEL) // 64)
        if side < 2 * overlap or room < _DIFFUSED * pixels:
            least += _WHOLE * pixels
            need = (least + max(_PER_PIXEL * (2 * overlap) ** 2, _DIFFUSED * pixels)) / 1e9
            raise ValueError(
                f"`memory` must be at least {need:.2g} GB for tiles that overlap by {overlap} px, "
                f"got {memory / 1e9:.3g} GB."
            )
        return Tiling(side, overlap)

    def of(self, height: int, width: int) -> list[Tile]:
        """All tiles of an image of height and width, px, row by row; at least one, of one shape.

        A ValueError if tiles are shorter than 24 px, or than twice what they overlap.
        """
        if self.overlap < 0 or self.side < max(2 * self.overlap, 24):
            raise ValueError(
                "`side` must be at least 24 px and at least twice `overlap`, which must not be "
                f"negative; got {self.side} and {self.overlap} px."
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
        side, count = length, 1
        while side > self.side:
            count += 1
            enough = math.ceil((length - self.overlap) / count) + self.overlap + _STEP - 1
            side = length - max(length - enough, 0) // _STEP * _STEP
        room = (length - side) // _STEP
        starts = [_STEP * round(room * k / max(count - 1, 1)) for k in range(count)]
        cuts = [0, *((a + side + b) // 2 for a, b in zip(starts, starts[1:], strict=False)), length]
        return [
            _Interval((start, side), (first, last - first))
            for start, first, last in zip(starts, cuts, cuts[1:], strict=False)
        ]


class _Interval(NamedTuple):
    """Along an axis, start and length of what is read and of what is kept."""

    window: tuple[int, int]
    core: tuple[int, int]
