"""What all figures share: sizes, color maps, color bars."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from jax import Array
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap
from matplotlib.figure import Figure

Numbers = Array | np.ndarray

WIDTH = 7.2  # inches: the text width of a two-column page
DISPARITY = "disparity (px per view step)"
SMALL = 8

_RC: dict[Any, Any] = {
    "font.size": SMALL,
    "axes.titlesize": SMALL,
    "axes.labelsize": SMALL,
    "axes.titlepad": 3.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.labelsize": SMALL - 1,
    "ytick.labelsize": SMALL - 1,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": SMALL - 1,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "image.interpolation": "nearest",
}

# Okabe and Ito: told apart by color-blind readers and in gray.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def style():
    """The settings under which figures and axes are made, as a context."""
    return mpl.rc_context(_RC)


def new_figure(width: float, height: float) -> Figure:
    """An empty figure that pyplot does not know."""
    figure = Figure(figsize=(width, height), dpi=200, layout="constrained")
    pads = {"w_pad": 0.03, "h_pad": 0.03, "wspace": 0.01, "hspace": 0.01}
    figure.get_layout_engine().set(**pads)  # pyright: ignore[reportOptionalMemberAccess]
    return figure


def color_map(name: str) -> Colormap:
    """A color map that shows missing values as a tint that it does not contain itself."""
    return mpl.colormaps[name].with_extremes(bad="#ff66cc")


def show(axes: Axes, image: Numbers, title: str = "", **options) -> ScalarMappable:
    """An image without ticks, framed by a thin line."""
    shown = axes.imshow(np.asarray(image), **options)
    axes.set(xticks=[], yticks=[], title=title)
    for spine in axes.spines.values():
        spine.set(visible=True, linewidth=0.4)
    return shown


def color_bar(
    figure: Figure, shown: ScalarMappable, axes: Axes | Sequence[Axes], label: str, **options
) -> None:
    """A slim color bar with a label that has the unit."""
    bar = figure.colorbar(shown, ax=axes, fraction=0.05, pad=0.015, aspect=28, **options)
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)  # pyright: ignore[reportCallIssue]


def check_names(names: Sequence[str] | None, count: int) -> list[str]:
    """One name per item, or a ValueError that says how many there are."""
    names = [""] * count if names is None else list(names)
    if len(names) != count:
        raise ValueError(f"`names` must have one entry for each of {count}, got {len(names)}.")
    return names
