"""Maps of all views: a sheet, and frames of a walk over the grid."""

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ._maps import disparity_limits
from ._style import Numbers, color_map, new_figure, show


def plot_view_maps(
    maps: Float[Numbers, "v u y x"],
    *,
    limits: tuple[float, float] | None = None,
    name: str = "disparity, px per view step",
    pixels: int = 1600,
) -> Figure:
    """Draws the maps of all views as one sheet, with one range.

    Args:
        maps: One per view, `[v, u, y, x]`.
        limits: Lowest and highest value of the colors; by default those of the maps.
        name: Title.
        pixels: Maps are thinned out so that the sheet is no wider than about this.

    Returns:
        The figure.
    """
    maps = np.asarray(maps)
    rows, columns, height, width = maps.shape
    every = max(1, -(-columns * width // pixels))
    small = maps[:, :, ::every, ::every]
    sheet = small.transpose(0, 2, 1, 3).reshape(rows * small.shape[2], columns * small.shape[3])
    limits = _limits(maps) if limits is None else limits
    figure = new_figure(8.0, 8.0 * sheet.shape[0] / sheet.shape[1] + 0.4)
    axes = figure.subplots()
    shown = show(axes, sheet, name, cmap=color_map("viridis"), norm=Normalize(*limits))
    figure.colorbar(shown, ax=axes, shrink=0.8)
    return figure


def view_frames(
    maps: Float[Numbers, "v u y x"], *, limits: tuple[float, float] | None = None
) -> list[UInt8[np.ndarray, "y x 3"]]:
    """Colored maps along the border of the grid, once around.

    Args:
        maps: One per view, `[v, u, y, x]`.
        limits: Lowest and highest value of the colors; by default those of the maps.

    Returns:
        Frames of an animation; of a single row or column, there and back.
    """
    maps = np.asarray(maps)
    scale = Normalize(*(_limits(maps) if limits is None else limits))
    colors = color_map("viridis")
    return [
        (255 * colors(scale(maps[place]))[..., :3]).astype(np.uint8)
        for place in around_the_grid(*maps.shape[:2])
    ]


def around_the_grid(rows: int, columns: int) -> list[tuple[int, int]]:
    """The views along the border of a grid, clockwise; of a single row, there and back."""
    top, right = [(0, u) for u in range(columns)], [(v, columns - 1) for v in range(1, rows)]
    bottom = [(rows - 1, u) for u in range(columns - 2, -1, -1)]
    left = [(v, 0) for v in range(rows - 2, 0, -1)]
    return [*top, *right, *bottom, *left]


def _limits(maps: np.ndarray) -> tuple[float, float]:
    return disparity_limits([m[::4, ::4] for m in maps.reshape(-1, *maps.shape[2:])])
