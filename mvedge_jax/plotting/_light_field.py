"""Views, epipolar-plane images and edges."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mvedge_jax.lightfield import LightField

from ._maps import disparity_limits
from ._style import DISPARITY, WIDTH, Numbers, color_bar, color_map, new_figure, show, style

_PAPER = to_rgb("#ffffff")
_ABSENT = to_rgb("#dddddd")
# Between the views of a mosaic, px.
_GAP = 4


def plot_views(light_field: LightField, *, pixels: int = 1600, width: float = WIDTH) -> Figure:
    """Draws all views as a mosaic, the center view framed.

    Args:
        light_field: What to draw; missing views are gray.
        pixels: Views are shrunk so that the mosaic is no wider than about this.
        width: Width of the figure, inches.

    Returns:
        The figure. Row v is counted from the top, column u from the left.
    """
    rows, columns, height, across, _ = light_field.views.shape
    available = np.asarray(light_field.available)
    factor = min(max(1, round(columns * across / pixels)), height, across)
    views = np.asarray(light_field.downsample(factor).views)
    height, across = views.shape[2:4]
    mosaic = np.empty((rows * (height + _GAP) - _GAP, columns * (across + _GAP) - _GAP, 3))
    mosaic[:] = _PAPER
    for v, u in np.ndindex(rows, columns):
        window = np.s_[
            v * (height + _GAP) : v * (height + _GAP) + height,
            u * (across + _GAP) : u * (across + _GAP) + across,
        ]
        mosaic[window] = np.clip(views[v, u], 0, 1) if available[v, u] else _ABSENT
    vc, uc = light_field.center
    with style():
        figure = new_figure(width, (width - 0.3) * mosaic.shape[0] / mosaic.shape[1] + 0.3)
        axes = figure.subplots()
        axes.imshow(mosaic, interpolation="antialiased")
        axes.set(
            xticks=(across + _GAP) * np.arange(columns) + across / 2,
            yticks=(height + _GAP) * np.arange(rows) + height / 2,
            xticklabels=range(columns),
            yticklabels=range(rows),
            xlabel="view column u",
            ylabel="view row v",
        )
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
        corner = (uc * (across + _GAP) - 0.5, vc * (height + _GAP) - 0.5)
        frame = Rectangle(corner, across, height, fill=False, edgecolor="#ff2020", linewidth=1.6)
        axes.add_patch(frame).set_clip_on(False)
    return figure


def plot_epi(
    light_field: LightField,
    *,
    row: int | None = None,
    column: int | None = None,
    positions: Float[Numbers, " m"] | None = None,
    disparities: Float[Numbers, " m"] | None = None,
    valid: Bool[Numbers, " m"] | None = None,
    limits: tuple[float, float] | None = None,
    width: float = WIDTH,
) -> Figure:
    """Draws an epipolar-plane image below the stretch of the center view that it is cut from.

    Args:
        light_field: The views.
        row: Image row of a horizontal EPI, px; the middle one if neither row nor column is given.
        column: Image column of a vertical EPI, px.
        positions: Where lines cross the center view, `[m]`, px along the EPI.
        disparities: Their disparities, `[m]`, px per view step.
        valid: Which of them to draw, `[m]`; all by default.
        limits: Color range of the lines, px per view step.
        width: Width of the figure, inches.

    Returns:
        The figure. The EPI is stretched across views so that slopes can be seen.

    Raises:
        ValueError: if both a row and a column are given, one of them is outside the image, or a
            line lacks its position or disparity.
    """
    if row is not None and column is not None:
        raise ValueError("`row` and `column` exclude each other, got both.")
    if (positions is None) != (disparities is None):
        raise ValueError("`positions` and `disparities` belong together, got one of them.")
    vc, uc = light_field.center
    sides = zip(("row", "column"), (row, column), light_field.views.shape[2:4], strict=True)
    for name, value, size in sides:
        if value is not None and not 0 <= value < size:
            raise ValueError(f"`{name}` must be from 0 to {size - 1}, got {value}.")
    if column is None:
        index = light_field.views.shape[2] // 2 if row is None else row
        epi, center = np.asarray(light_field.horizontal_arm[:, index]), uc
        picture, labels = np.asarray(light_field.center_view), ("x (px)", "view u")
    else:
        index, center = column, vc
        epi = np.asarray(light_field.vertical_arm[:, :, index])
        picture = np.asarray(light_field.center_view).swapaxes(0, 1)
        labels = ("y (px)", "view v")
    views, length = epi.shape[:2]
    inches = width - (0.45 if positions is None else 1.15)
    band = max(8, round(length / 8))
    top = min(max(index - band // 2, 0), max(picture.shape[0] - band, 0))
    strip = picture[top : top + band]
    heights = [inches * strip.shape[0] / length, max(inches * 0.2, 0.09 * views)]
    with style():
        figure = new_figure(width, sum(heights) + 0.5)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=heights)
        frame = (-0.5, length - 0.5, top + strip.shape[0] - 0.5, top - 0.5)
        upper.imshow(np.clip(strip, 0, 1), extent=frame, aspect="auto")
        upper.axhline(index, color="#ff3030", linewidth=0.8, linestyle=(0, (6, 3)))
        upper.set(ylabel=("y" if column is None else "x") + " (px)")
        upper.tick_params(labelbottom=False)
        lower.imshow(np.clip(epi, 0, 1), extent=(-0.5, length - 0.5, views - 0.5, -0.5))
        lower.set_aspect("auto")
        lower.set(xlabel=labels[0], ylabel=labels[1], yticks=sorted({0, center, views - 1}))
        if positions is not None and disparities is not None:
            keep = np.ones(len(positions), bool) if valid is None else np.asarray(valid)
            at, slope = np.asarray(positions)[keep], np.asarray(disparities)[keep]
            _draw_lines(figure, [upper, lower], at, slope, center, views, limits)
        lower.set(xlim=(-0.5, length - 0.5), ylim=(views - 0.5, -0.5))
    return figure


def _draw_lines(figure, axes, positions, disparities, center, views, limits) -> None:
    ends = np.array([-0.5, views - 0.5])
    x = positions[:, None] + (center - ends) * disparities[:, None]
    segments = np.stack([x, np.broadcast_to(ends, x.shape)], -1)
    low, high = disparity_limits([disparities[None]], percent=0.0) if limits is None else limits
    scale = Normalize(low, high)
    casing = LineCollection(list(segments), colors="black", linewidths=2.0)
    lines = LineCollection(list(segments), cmap=color_map("viridis"), norm=scale, linewidths=1.2)
    lines.set_array(disparities)
    axes[1].add_collection(casing)
    axes[1].add_collection(lines)
    color_bar(figure, lines, axes, DISPARITY)


def plot_edges(
    image: Float[Numbers, "y x c"],
    points: Float[Numbers, "n 2"],
    disparity: Float[Numbers, " n"],
    *,
    valid: Bool[Numbers, " n"] | None = None,
    limits: tuple[float, float] | None = None,
    size: float = 1.5,
    name: str = "",
    width: float = WIDTH / 2,
) -> Figure:
    """Draws edge points over a dimmed image, colored by their disparity.

    Args:
        image: sRGB in [0, 1], `[y, x, c]`.
        points: `(x, y)` of the points, `[n, 2]`, px.
        disparity: `[n]`, px per view step.
        valid: Which points to draw, `[n]`; all by default.
        limits: Color range, px per view step; by default that of the points.
        size: Diameter of a point, px of the image.
        name: Title.
        width: Width of the figure, inches.

    Returns:
        The figure; near points are drawn over far ones.
    """
    values = np.asarray(disparity)
    keep = np.ones(len(values), bool) if valid is None else np.asarray(valid)
    values, xy = values[keep], np.asarray(points)[keep]
    limits = disparity_limits([values[None]]) if limits is None else limits
    picture = np.clip(np.asarray(image), 0, 1).mean(-1) * 0.45 + 0.55
    inches = width - 0.75
    with style():
        height = inches * picture.shape[0] / picture.shape[1]
        figure = new_figure(width, height + (0.25 if name else 0.06))
        axes = figure.subplots()
        show(axes, picture, name, cmap="gray", vmin=0, vmax=1)
        order = np.argsort(values)
        diameter = size * inches * 72 / picture.shape[1]  # points of 1/72 inch
        shown = axes.scatter(
            *xy[order].T,
            c=values[order],
            s=diameter**2,
            cmap=color_map("viridis"),
            norm=Normalize(*limits),
            linewidths=0,
        )
        color_bar(figure, shown, axes, DISPARITY)
    return figure
