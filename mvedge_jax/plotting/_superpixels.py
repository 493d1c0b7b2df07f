"""Superpixels: their boundaries over a view, sheets and walks over all views."""

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure

from ._style import WIDTH, Numbers, color_bar, color_map, new_figure, show, style
from ._views import around_the_grid

# Neighboring labels get colors far apart on the circle of hues.
_GOLDEN = 0.618033988749895


def superpixel_picture(
    image: Float[Numbers, "y x 3"],
    labels: Int[Numbers, "y x"],
    *,
    colors: Float[Numbers, "k 3"] | None = None,
    outline: tuple[float, float, float] | None = (1.0, 0.85, 0.0),
) -> UInt8[np.ndarray, "y x 3"]:
    """Draws superpixels into a view.

    Args:
        image: the view, sRGB in [0, 1].
        labels: of its pixels, 0 for none.
        colors: of each label, row k that of label k + 1: drawn instead of the view; where there is
            no label, the view stays.
        outline: color of the pixels to the right of and below a boundary; None for no outlines.

    Returns:
        The picture, 8 bit.
    """
    labels = np.asarray(labels)
    picture = np.array(image, float)
    if colors is not None:
        table = np.asarray(colors)
        there = labels > 0
        picture[there] = table[labels[there] - 1]
    if outline is not None:
        edge = np.zeros(labels.shape, bool)
        edge[:, 1:] |= labels[:, 1:] != labels[:, :-1]
        edge[1:] |= labels[1:] != labels[:-1]
        picture[edge] = outline
    return np.round(255 * np.clip(picture, 0, 1)).astype(np.uint8)


def label_colors(count: int) -> Float[np.ndarray, "k 3"]:
    """Bright colors to tell labels apart, the same in every picture.

    Args:
        count: of labels.

    Returns:
        sRGB in [0, 1]; row k is the color of label k + 1.
    """
    number = np.arange(count)
    hue = (number * _GOLDEN) % 1
    value, strength = 0.75 + 0.25 * (number % 3) / 2, 0.55 + 0.35 * (number % 5) / 4
    return hsv_to_rgb(np.stack([hue, strength, value], axis=-1))


def plot_superpixels(
    views: Float[Numbers, "v u y x 3"],
    labels: Int[Numbers, "v u y x"],
    *,
    colors: Float[Numbers, "k 3"] | None = None,
    width: float = 2 * WIDTH,
) -> Figure:
    """Draws superpixels in the center view and the four corner views.

    Args:
        views: sRGB in [0, 1].
        labels: of all pixels, 0 for none.
        colors: of each label, drawn instead of the views.
        width: of the figure, inches.

    Returns:
        The figure; of a single row or column of views, the center and the two ends.
    """
    rows, columns, height, across = labels.shape
    corners = [(0, 0), (0, columns - 1), (rows - 1, 0), (rows - 1, columns - 1)]
    places = list(dict.fromkeys([(rows // 2, columns // 2), *corners]))
    with style():
        side = width / len(places)
        figure = new_figure(width, side * height / across + 0.25)
        axes = figure.subplots(1, len(places), squeeze=False)[0]
        for axis, (v, u) in zip(axes, places, strict=True):
            picture = superpixel_picture(views[v, u], labels[v, u], colors=colors)
            show(axis, picture, f"view ({v}, {u})")
    return figure


def superpixel_frames(
    views: Float[Numbers, "v u y x 3"],
    labels: Int[Numbers, "v u y x"],
    *,
    colors: Float[Numbers, "k 3"] | None = None,
) -> list[UInt8[np.ndarray, "y x 3"]]:
    """Superpixels along the border of the grid of views, once around: flicker shows here.

    Args:
        views: sRGB in [0, 1].
        labels: of all pixels, 0 for none.
        colors: of each label, drawn instead of the views.

    Returns:
        Frames of an animation; of a single row or column, there and back.
    """
    places = around_the_grid(*labels.shape[:2])
    return [superpixel_picture(views[p], labels[p], colors=colors) for p in places]


def plot_labels_per_pixel(counts: Float[Numbers, "y x"], *, width: float = WIDTH / 2) -> Figure:
    """Draws how many labels each pixel of the center view has: Fig. 5.9.

    Args:
        counts: from `metrics.superpixels.labels_per_pixel`.
        width: of the figure, inches.

    Returns:
        The figure; blue is one label, the same in all views that see the pixel.
    """
    counts = np.asarray(counts)
    with style():
        figure = new_figure(width, (width - 0.75) * counts.shape[0] / counts.shape[1] + 0.06)
        axes = figure.subplots()
        shown = show(axes, counts, cmap=color_map("turbo"), vmin=1, vmax=max(8, counts.max()))
        color_bar(figure, shown, axes, "labels per pixel")
    return figure
