"""Precision-recall curves, view consistency, calibration."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mvedge_jax.metrics import BoundaryScores, Calibration, ViewConsistency

from ._style import COLORS, WIDTH, check_names, color_bar, color_map, new_figure, show, style


def _line(number: int) -> dict[str, Any]:
    """Color and dashes of a curve, by its number."""
    dashes = ("-", "--", "-.")[number // len(COLORS) % 3]
    return {"color": COLORS[number % len(COLORS)], "linestyle": dashes}


def plot_precision_recall(
    scores: Sequence[BoundaryScores],
    *,
    names: Sequence[str] | None = None,
    width: float = WIDTH / 2,
) -> Figure:
    """Draws precision over recall of depth boundaries, with lines of equal F1 (Fig. 6.4).

    Args:
        scores: One per method, from `metrics.boundary_scores`.
        names: A label per method; its peak F1 is added.
        width: Width of the figure, inches.

    Returns:
        The figure; a dot marks the threshold of the best F1.

    Raises:
        ValueError: if the number of names is not that of the scores.
    """
    names = check_names(names, len(scores))
    with style():
        figure = new_figure(width, 0.9 * width)
        axes = figure.subplots()
        recall = np.linspace(0.01, 1, 200)
        for level in (0.2, 0.4, 0.6, 0.8):
            with np.errstate(divide="ignore"):
                precision = level * recall / (2 * recall - level)
            shown = (precision > 0) & (precision <= 1)
            axes.plot(recall[shown], precision[shown], color="#cccccc", linewidth=0.6, zorder=0)
            axes.annotate(
                f"F1 = {level}",
                (1, level / (2 - level)),
                xytext=(-1, 2),
                textcoords="offset points",
                ha="right",
                fontsize=6,
                color="#999999",
            )
        for number, (score, name) in enumerate(zip(scores, names, strict=True)):
            curve = np.stack([np.asarray(score.recall), np.asarray(score.precision)])
            curve = curve[:, curve[0] > 0]
            label = f"{name} ({float(score.peak_f1):.2f})"
            axes.plot(curve[0], curve[1], label=label, **_line(number))
            best = int(np.argmax(np.asarray(score.f1)))
            at = (float(score.recall[best]), float(score.precision[best]))
            axes.plot(at[0], at[1], "o", markersize=3.5, color=_line(number)["color"])
        axes.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
        axes.set_aspect("equal", adjustable="box")
        axes.legend(title="peak F1 in brackets", title_fontsize=7, loc="lower left")
    return figure


def plot_consistency(
    scores: Sequence[ViewConsistency], *, names: Sequence[str] | None = None, width: float = WIDTH
) -> Figure:
    """Draws how the disagreement between views is distributed (Fig. 6.5).

    Args:
        scores: One per method, from `metrics.view_consistency`.
        names: A label per method.
        width: Width of the figure, inches.

    Returns:
        The figure: a box plot over views per method (box: quartiles, whiskers: 1.5 times the box,
        line: median) and, on one color scale, its angular distribution.

    Raises:
        ValueError: if the number of names is not that of the scores.
    """
    if not scores:
        raise ValueError("`scores` must hold at least one method's, got none.")
    names = check_names(names, len(scores))
    grids = [np.asarray(score.per_view) for score in scores]
    finite = [grid[np.isfinite(grid)] for grid in grids]
    high = max((values.max() for values in finite if values.size), default=1.0) or 1.0
    count = len(grids)
    with style():
        figure = new_figure(width, 0.25 + min(2.4, 0.72 * width / (count + 1.2)) + 0.35)
        axes = figure.subplots(1, count + 1, width_ratios=[1.25] + [1] * count)
        thin = {"linewidth": 0.7}
        boxes = axes[0].boxplot(
            finite,
            widths=0.55,
            patch_artist=True,
            flierprops={"markersize": 2.5, "markeredgewidth": 0.7},
            whiskerprops=thin,
            capprops=thin,
            medianprops={"linewidth": 1.0, "color": "black"},
        )
        for number, patch in enumerate(boxes["boxes"]):
            patch.set(facecolor=COLORS[number % len(COLORS)], alpha=0.55, linewidth=0.6)
        axes[0].set(ylabel="variance between views (px²)", ylim=(0, 1.05 * high))
        axes[0].set_xticks(range(1, count + 1), names)
        options = {"cmap": color_map("inferno"), "vmin": 0, "vmax": high}
        shown = [
            show(ax, grid, name, **options)
            for ax, grid, name in zip(axes[1:], grids, names, strict=True)
        ]
        for ax, grid in zip(axes[1:], grids, strict=True):
            rows, columns = grid.shape
            ax.set(xticks=[0, columns // 2, columns - 1], yticks=[0, rows // 2, rows - 1])
            ax.set(xlabel="view u", ylabel="view v" if ax is axes[1] else "")
        color_bar(figure, shown[-1], list(axes[1:]), "variance between views (px²)")
    return figure


def plot_calibration(
    found: Sequence[Calibration], *, names: Sequence[str] | None = None, width: float = WIDTH
) -> Figure:
    """Draws errors over their estimates, and what is left when the least certain pixels go.

    Args:
        found: One per map, from `metrics.calibration`.
        names: A label per map; the share within two standard errors, and the area between the
            curves, are added.
        width: Width of the figure, inches.

    Returns:
        The figure. Left: true estimates lie on the diagonal, those above it are too small. Right:
        dotted, the order that knows the truth.

    Raises:
        ValueError: if the number of names is not that of the maps, or no map has a pixel whose
            standard error is finite.
    """
    names = check_names(names, len(found))
    predicted = [np.asarray(each.predicted) for each in found]
    drawn = np.concatenate([values[np.isfinite(values)] for values in predicted] or [[]])
    if not drawn.size:
        raise ValueError("`found` has no pixel of a finite standard error: nothing to draw.")
    with style():
        figure = new_figure(width, 0.45 * width)
        left, right = figure.subplots(1, 2)
        ends = [float(end(drawn)) for end in (np.min, np.max)]
        left.plot(ends, ends, color="#cccccc", linewidth=0.8, zorder=0)
        for number, (each, name) in enumerate(zip(found, names, strict=True)):
            line, found_error = _line(number), np.maximum(each.found, 1e-5)
            label = f"{name} ({100 * each.within[1]:.0f} %, {each.ause:.2f})"
            left.plot(each.predicted, found_error, label=label, **line)
            right.plot(each.left_out, each.sparsified, **line)
            right.plot(each.left_out, each.oracle, color=line["color"], linestyle=":")
        left.set(
            xscale="log",
            yscale="log",
            xlabel="standard error (px per view step)",
            ylabel="error of 68 % of the pixels",
        )
        right.set(
            xlim=(0, 1), ylim=(0, None), xlabel="share left out", ylabel="mean error of the rest"
        )
        # Beside the curves, which fill both axes where there are many maps.
        figure.legend(loc="outside right center", title="within two, area", fontsize=6)
    return figure
