"""Disparity maps and their errors."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from ._style import (
    DISPARITY,
    SMALL,
    WIDTH,
    Numbers,
    check_names,
    color_bar,
    color_map,
    new_figure,
    show,
    style,
)

_LOG_LIMITS = (1e-3, 1.0)
_LOG_LABEL = "absolute error (px per view step)"
_SIGNED_LABEL = "error (px per view step)"


def disparity_limits(
    maps: Sequence[Float[Numbers, "_ _"]], *, percent: float = 0.5
) -> tuple[float, float]:
    """A color range that all maps of a scene can share.

    Args:
        maps: Disparity maps, `[y, x]` each, any unit: the ground truth alone, or, without one,
            all maps that are to be compared.
        percent: Share of the values left out at either end, 0..50.

    Returns:
        Lowest and highest value, different from each other. Values that are not finite are
        ignored; without any others the range is (0, 1).
    """
    values = np.concatenate([np.asarray(m).ravel() for m in maps])
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = np.percentile(values, [percent, 100 - percent])
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(low) + 0.5)


def plot_disparity(
    maps: Sequence[Float[Numbers, "y x"]] | Float[Numbers, "y x"],
    *,
    names: Sequence[str] | None = None,
    limits: tuple[float, float] | None = None,
    label: str = DISPARITY,
    width: float = WIDTH,
) -> Figure:
    """Draws disparity maps side by side, with one color map, range and bar.

    Args:
        maps: One map or several of one scene, `[y, x]` each, px per view step.
        names: A title per map.
        limits: Color range, px per view step; by default `disparity_limits` of all maps. Pass the
            same to every figure of a scene.
        label: Of the color bar.
        width: Width of the figure, inches.

    Returns:
        The figure. Values that are not finite are pink.

    Raises:
        ValueError: if the number of names is not that of the maps.
    """
    listed = _listed(maps)
    names = check_names(names, len(listed))
    limits = disparity_limits(listed) if limits is None else limits
    height, columns = listed[0].shape[0] / listed[0].shape[1], len(listed)
    side = (width - 0.75) / columns
    with style():
        figure = new_figure(width, side * height + (0.25 if any(names) else 0.06))
        axes = figure.subplots(1, columns, squeeze=False)[0]
        options = {"cmap": color_map("viridis"), "norm": Normalize(*limits)}
        shown = [
            show(ax, values, name, **options)
            for ax, values, name in zip(axes, listed, names, strict=True)
        ]
        color_bar(figure, shown[-1], list(axes), label)
    return figure


def plot_error(
    disparity: Float[Numbers, "y x"],
    truth: Float[Numbers, "y x"],
    *,
    kind: Literal["signed", "log"] = "log",
    limit: float = 0.1,
    name: str = "",
    label: str | None = None,
    width: float = WIDTH / 2,
) -> Figure:
    """Draws where a disparity map is wrong.

    Args:
        disparity: The map, `[y, x]`, px per view step.
        truth: Ground truth, `[y, x]`, px per view step; NaN where unknown.
        kind: `signed` for map minus truth (red: too near), `log` for its absolute value on a
            logarithmic scale from 0.001 to 1 px.
        limit: Error at the ends of the signed scale, px per view step; larger ones are clipped.
        name: Title.
        label: Of the color bar; None for the error, absolute on the logarithmic scale.
        width: Width of the figure, inches.

    Returns:
        The figure. Pink: not finite in the map or unknown in the truth.

    Raises:
        ValueError: if the shapes differ or `kind` is another word.
    """
    error = _error(disparity, truth)
    if kind not in {"signed", "log"}:
        raise ValueError(f"`kind` must be 'signed' or 'log', got {kind!r}.")
    height = (width - 0.75) * error.shape[0] / error.shape[1]
    with style():
        figure = new_figure(width, height + (0.25 if name else 0.06))
        axes = figure.subplots()
        if kind == "log":
            shown = _show_log(axes, error, name)
            color_bar(figure, shown, axes, label or _LOG_LABEL, extend="both")
        else:
            scale = Normalize(-limit, limit)
            shown = show(axes, error, name, cmap=color_map("RdBu_r"), norm=scale)
            color_bar(figure, shown, axes, label or _SIGNED_LABEL, extend="both")
    return figure


def plot_comparison(
    maps: Sequence[Float[Numbers, "y x"]],
    truth: Float[Numbers, "y x"],
    *,
    names: Sequence[str] | None = None,
    captions: Sequence[str] | None = None,
    image: Float[Numbers, "y x c"] | None = None,
    limits: tuple[float, float] | None = None,
    width: float = WIDTH,
) -> Figure:
    """Draws the truth and several methods' maps above their log errors, all on the same scales.

    Args:
        maps: The methods' maps, `[y, x]` each, px per view step.
        truth: Ground truth, `[y, x]`, px per view step; NaN where unknown.
        names: A title per method.
        captions: A line below each error map, for example its scores.
        image: The center view, sRGB in [0, 1], drawn below the truth.
        limits: Color range of disparity; by default that of the truth.
        width: Width of the figure, inches.

    Returns:
        The figure.

    Raises:
        ValueError: if shapes or the numbers of names and captions do not fit.
    """
    listed = _listed(maps)
    names = check_names(names, len(listed))
    captions = check_names(captions, len(listed))
    truth = np.asarray(truth)
    errors = [_error(values, truth) for values in listed]
    limits = disparity_limits([truth], percent=0.0) if limits is None else limits
    side = (width - 0.8) / (len(listed) + 1)
    with style():
        height = 2 * side * truth.shape[0] / truth.shape[1] + 0.5
        figure = new_figure(width, height)
        axes = figure.subplots(2, len(listed) + 1, squeeze=False)
        titles = ["ground truth", *names]
        options = {"cmap": color_map("viridis"), "norm": Normalize(*limits)}
        shown = [
            show(ax, values, title, **options)
            for ax, values, title in zip(axes[0], [truth, *listed], titles, strict=True)
        ]
        color_bar(figure, shown[-1], list(axes[0]), DISPARITY)
        if image is None:
            axes[1, 0].set_axis_off()
        else:
            show(axes[1, 0], np.clip(np.asarray(image), 0, 1))
            axes[1, 0].set_xlabel("center view", fontsize=SMALL - 1)
        shown = [_show_log(ax, error, "") for ax, error in zip(axes[1, 1:], errors, strict=True)]
        for ax, caption in zip(axes[1, 1:], captions, strict=True):
            ax.set_xlabel(caption, fontsize=SMALL - 1)
        color_bar(figure, shown[-1], list(axes[1]), _LOG_LABEL, extend="both")
    return figure


def _show_log(axes, error: np.ndarray, name: str):
    size = np.maximum(np.abs(error), 1e-12)  # an exact pixel is at the scale's end, not missing
    return show(axes, size, name, cmap=color_map("inferno"), norm=LogNorm(*_LOG_LIMITS))


def _error(disparity: Numbers, truth: Numbers) -> np.ndarray:
    disparity, truth = np.asarray(disparity), np.asarray(truth)
    if disparity.shape != truth.shape:
        raise ValueError(
            f"`truth` must have the shape of the map, {disparity.shape}, got {truth.shape}."
        )
    finite = np.isfinite(disparity) & np.isfinite(truth)
    return np.where(finite, np.where(finite, disparity, 0) - np.where(finite, truth, 0), np.nan)


def _listed(maps: Sequence[Numbers] | Numbers) -> list[np.ndarray]:
    maps = [maps] if isinstance(maps, Numbers) and maps.ndim == 2 else list(maps)
    if not maps:
        raise ValueError("`maps` must hold at least one map, got none.")
    return [np.asarray(values) for values in maps]
