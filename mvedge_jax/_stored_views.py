"""The crosshair of a light field as its files hold it, for images that are read in parts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Bool, Float, Shaped

from mvedge_jax.lightfield import Camera, LightField

# Pictures of this shorter side still show what a calibration asks for.
_SMALL = 512


class Window(NamedTuple):
    """A part of an image.

    Attributes:
        top: its first row.
        left: its first column.
        height: px.
        width: px.
    """

    top: int
    left: int
    height: int
    width: int

    def of(self, image: np.ndarray) -> np.ndarray:
        """That part of an image `[y, x, ...]`."""
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


@dataclass(frozen=True)
class StoredViews:
    """The center row and the center column of views in the memory of the host.

    Colors stay in the 8 or 16 bits of their files, and no memory is kept for other views: of 9x9
    views, a twentieth of what a `LightField` takes.

    Attributes:
        planes: view `[y, x, 3]` by its place `(v, u)`: uint8, uint16, or float in [0, 1].
        grid: rows and columns of views.
        positions: see `LightField`.
        disparity_range: see `LightField`.
        camera: see `LightField`.
        name: see `LightField`.
    """

    planes: Mapping[tuple[int, int], Shaped[np.ndarray, "y x 3"]]
    grid: tuple[int, int]
    positions: Float[np.ndarray, "v u 2"] | None = None
    disparity_range: tuple[float, float] | None = None
    camera: Camera | None = None
    name: str = "light field"

    def __post_init__(self) -> None:
        """Refuses colors that are none, once for all windows."""
        for (v, u), plane in self.planes.items():
            if not np.issubdtype(plane.dtype, np.floating):
                continue
            low, high = float(plane.min()), float(plane.max())
            if not (low >= -1e-3 and high <= 1 + 1e-3):
                raise ValueError(
                    f"`planes` must be sRGB in [0, 1], got values from {low:.4g} to {high:.4g} in "
                    f"view (v, u) = ({v}, {u})."
                )

    @staticmethod
    def of(light_field: LightField) -> "StoredViews":
        """The crosshair of a light field, without a copy where it is in the host's memory."""
        views, there = np.asarray(light_field.views), np.asarray(light_field.available)
        vc, uc = light_field.center
        places = [(v, u) for v, u in np.argwhere(there).tolist() if v == vc or u == uc]
        known, positions = light_field.disparity_range, light_field.positions
        return StoredViews(
            {place: views[place] for place in places},
            (views.shape[0], views.shape[1]),
            None if positions is None else np.asarray(positions),
            None if known is None else (float(known[0]), float(known[1])),
            light_field.camera,
            light_field.name,
        )

    @property
    def center(self) -> tuple[int, int]:
        """`(v_c, u_c)`, the place of the center view."""
        return self.grid[0] // 2, self.grid[1] // 2

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Rows and columns of views, their height and width in px."""
        height, width = self.planes[self.center].shape[:2]
        return *self.grid, height, width

    @property
    def size(self) -> int:
        """Bytes of all views."""
        return sum(plane.nbytes for plane in self.planes.values())

    @property
    def available(self) -> Bool[np.ndarray, "v u"]:
        """Which views are there."""
        there = np.zeros(self.grid, bool)
        for place in self.planes:
            there[place] = True
        return there

    @property
    def center_view(self) -> Float[np.ndarray, "y x 3"]:
        """The center view, sRGB in [0, 1], float32."""
        plane = self.planes[self.center]
        return (plane / _white(plane)).astype(np.float32)

    def window(self, window: Window) -> LightField:
        """A part of every view as a light field of the same positions.

        Args:
            window: within the views.

        Returns:
            float32, without ground truth; views off the crosshair are missing.
        """
        views = blank((*self.grid, window.height, window.width, 3))
        for place, plane in self.planes.items():
            np.divide(window.of(plane), _white(plane), out=views[place], casting="same_kind")
        return self._light_field(views, self.disparity_range)

    def shrunk(self) -> tuple[LightField, int]:
        """Small pictures of the views, and by which factor they are smaller.

        Returns:
            Averages over areas, and the side of these, px; disparities are smaller likewise.
        """
        factor = max(1, min(self.shape[2:]) // _SMALL)
        height, width = (side // factor for side in self.shape[2:])
        views = np.zeros((*self.grid, height, width, 3), np.float32)
        for place, plane in self.planes.items():
            # First along whole rows, as NumPy is slow at sums over few neighbors.
            whole = plane[: height * factor, : width * factor]
            rows = whole.reshape(height, factor, -1).mean(1, dtype=np.float32)
            areas = rows.reshape(height, width, factor, 3)
            views[place] = areas.mean(2) / _white(plane)
        known = self.disparity_range
        limits = None if known is None else (known[0] / factor, known[1] / factor)
        return self._light_field(views, limits), factor

    def _light_field(self, views: np.ndarray, limits: tuple[float, float] | None) -> LightField:
        # Its checks would read every view again.
        field = LightField(
            np.zeros((*self.grid, 1, 1, 3), np.float32),
            available=self.available,
            positions=self.positions,
            disparity_range=limits,
            name=self.name,
        )
        return eqx.tree_at(lambda field: field.views, field, jax.device_put(views))


def blank(shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> np.ndarray:
    """Zeros that JAX takes without a copy on a CPU; parts that nobody writes take no memory.

    Args:
        shape: of the array.
        dtype: of the array.

    Returns:
        The array, which must not be written once JAX has it.
    """
    aligned, size = 64, math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.zeros(size + aligned, np.uint8)
    start = -memory.ctypes.data % aligned
    return memory[start : start + size].view(dtype).reshape(shape)


def _white(plane: np.ndarray) -> np.float32:
    """What stands for white."""
    whole = np.issubdtype(plane.dtype, np.integer)
    return np.float32(np.iinfo(plane.dtype).max if whole else 1)
