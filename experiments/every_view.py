"""Depth of every view: errors, hidden surfaces, consistency, seconds; Figures 6.5, 6.6 and B.2.

    python experiments/every_view.py demo edges crossing thin wide room bench --out results/views
    python experiments/every_view.py ../shared/data/lytro/2067 --views 7 --out results/lytro

Scenes are folders, names of the development data, or of synthetic scenes (rendered at --size).
All methods start from the same map of the center view; its seconds are not in theirs, those of
finding the thesis' guides are. Per method and scene, MSE x 100 and share of pixels off by more than
.07 px: mean over the views, mean of the corner views, pixels whose true surface the center view
does not show (mean over the off-center views), and the center view itself. `off/center` is the MSE
of the off-center views over that of the center. `cons` is the variance of map - truth between the
views that truly see a point, x 100; `agree` is `metrics.view_consistency`, which knows no truth,
x 100: a constant map agrees. `6.10` is that equation as the thesis prints it, x 100, see
`peers.printed_consistency`; the true maps have `truth 6.10`. A scene without truth in all
views (HCI's, Stanford's, Lytro's) has only `agree`, `6.10` and the seconds, as in the thesis, which
uses the central 7x7 views of a Lytro's.

With --cost, the seconds of every view over the number of views, ours.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from _report import peak_memory, print_table, timed, write_csv, write_json
from _views import error_consistency, regions, scene, scores
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from peers.printed_consistency import printed_view_consistency
from peers.reprojection import reproject_views
from peers.thesis_views import Guiding, thesis_views

from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.depth import DepthResult, EdgeDepth, multiview_edges
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import view_consistency
from mvedge_jax.plotting import plot_consistency, plot_view_maps

Method = Callable[[LightField, DepthResult], jax.Array]


def ours(light_field: LightField, result: DepthResult) -> jax.Array:
    """Common surface samples, drawn into every view."""
    model = ViewDepth.for_light_field(light_field)
    return depth_of_views(light_field, result, model).disparity


def naive(light_field: LightField, result: DepthResult) -> jax.Array:
    """The center view's map moved, holes filled from behind."""
    return reproject_views(result.disparity, light_field.steps)


def thesis(light_field: LightField, result: DepthResult) -> jax.Array:
    """The center view's map, projected and diffused in EPIs, guided by the thesis' points."""
    choices = {"edges.hidden": True, "edges.lines.visibility": "crossed"}
    model = EdgeDepth.for_light_field(light_field, preset="thesis", choices=choices)
    points = multiview_edges(light_field, model, key=jax.random.key(0)).points
    return thesis_views(light_field, result.disparity, points, Guiding())


METHODS: dict[str, Method] = {"ours": ours, "naive": naive, "thesis": thesis}
ERROR = "error, px"
# Of a column: the end of the name of Figure 6.6, and the label of its axis.
SCATTERED = {
    "cons": ("", "variance of the error between views x 100"),
    "6.10": ("_printed", "Eq. 6.10 as printed x 100"),
}


def costs(light_field: LightField) -> list[dict[str, Any]]:
    """Seconds of all views over their number, warm and first call."""
    rows = []
    most = min(light_field.views.shape[:2])
    for side in range(3, most + 1, 2):
        field = light_field.without_truth().crop_views(side)
        result = EdgeDepth.for_light_field(field)(field)
        _, seconds = timed(ours, field, result, repeats=2)
        each = seconds.best / side**2
        row = {"views": side**2, "seconds": seconds.best, "per view": each}
        rows.append({**row, "first call": seconds.first})
    return rows


def main() -> None:
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--out", type=Path, default=Path("results/every_view"))
    parser.add_argument("--size", type=int, default=512, help="side of rendered scenes, px")
    parser.add_argument("--views", type=int, help="use the central VIEWS x VIEWS only")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--repeats", type=int, default=2, help="warm calls; the best counts")
    parser.add_argument("--cost", action="store_true", help="plot seconds over number of views")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows, cost = [], []
    for place in arguments.scenes:
        name, light_field = Path(place).name, scene(place, arguments.size)
        if arguments.views:
            light_field = light_field.crop_views(arguments.views)
        rows += compared(name, light_field, arguments)
        if arguments.cost and not cost:
            cost = costs(light_field)
            print_table(cost, title=f"seconds of ours, {name}")
            _cost_plot(cost).savefig(arguments.out / "cost.png")
        # Programs of the whole chain are dropped, see `_scenes.scenes`.
        jax.clear_caches()
        # After every scene: all of them take a while. Scenes without truth lack columns.
        columns = dict.fromkeys(column for row in rows for column in row)
        write_csv(
            arguments.out / "every_view.csv", [{c: row.get(c) for c in columns} for row in rows]
        )
        content = {"rows": rows, "cost": cost, "peak GiB": peak_memory() / 2**30}
        write_json(arguments.out / "every_view.json", content)
        for column, (end, label) in SCATTERED.items():
            if scored := [row for row in rows if column in row]:
                figure = _scatter(scored, column, label)
                figure.savefig(arguments.out / f"figure_6_6{end}.png")


def compared(
    name: str, light_field: LightField, arguments: argparse.Namespace
) -> list[dict[str, Any]]:
    """The rows of one scene; its pictures are written."""
    known, blind = light_field.truth, light_field.without_truth()
    truth = None if known is None else known.view_disparity
    hidden = None if truth is None else regions(np.asarray(truth))
    result = EdgeDepth.for_light_field(blind)(blind)
    there = light_field.available
    rows, errors, printed, slices = [], [], [], {}
    for method in arguments.methods:
        maps, seconds = timed(METHODS[method], blind, result, repeats=arguments.repeats)
        row = {"scene": name, "method": method}
        if truth is not None and hidden is not None:
            errors.append(error_consistency(maps, truth))
            row |= {**scores(maps, truth, hidden), "cons": 100 * float(errors[-1].mean)}
            row["truth 6.10"] = 100 * float(printed_view_consistency(truth, available=there).mean)
            figure = plot_view_maps(np.abs(np.asarray(maps - truth)), limits=(0, 0.3), name=ERROR)
            figure.savefig(arguments.out / f"{name}_{method}_error.png")
        agree = view_consistency(maps, available=there).mean
        printed.append(printed_view_consistency(maps, available=there))
        row |= {"agree": 100 * float(agree), "6.10": 100 * float(printed[-1].mean)}
        rows.append({**row, "seconds": seconds.best, "first call": seconds.first})
        plot_view_maps(maps).savefig(arguments.out / f"{name}_{method}.png")
        slices[method] = np.asarray(maps[light_field.center[0]][:, light_field.views.shape[2] // 2])
    if truth is not None:
        slices["truth"] = np.asarray(truth[light_field.center[0], :, truth.shape[2] // 2])
    _slices(slices).savefig(arguments.out / f"figure_b_2_{name}.png")
    figures = {"": errors, "_printed": printed}
    for end, found in figures.items():
        if found:
            figure = plot_consistency(found, names=arguments.methods)
            figure.savefig(arguments.out / f"figure_6_5_{name}{end}.png")
    print_table(rows, title=name)
    return rows


def _slices(maps: dict[str, np.ndarray]) -> Figure:
    """Disparity along the EPI of the middle row, `[u, x]`, a strip per method (Fig. B.2)."""
    figure = Figure(figsize=(7, 0.9 * len(maps) + 0.2), layout="constrained")
    low, high = (f([f(each) for each in maps.values()]) for f in (np.min, np.max))
    strips = figure.subplots(len(maps), 1, squeeze=False)[:, 0]
    for axes, (method, each) in zip(strips, maps.items(), strict=True):
        axes.imshow(each, aspect="auto", vmin=low, vmax=high, interpolation="nearest")
        axes.set(ylabel=method, xticks=[], yticks=[])
    return figure


def _scatter(rows: list[dict[str, Any]], column: str, label: str) -> Figure:
    """Seconds against consistency, a mark per scene and a color per method (Fig. 6.6)."""
    figure = Figure(figsize=(4.5, 3.4), layout="constrained")
    axes = figure.subplots()
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        seconds, heights = ([row[name] for row in own] for name in ("seconds", column))
        axes.semilogx(seconds, heights, "o", label=method)
        for row in own:
            axes.annotate(row["scene"], (row["seconds"], row[column]), fontsize=6)
    axes.set(xlabel="seconds for all views", ylabel=label, ylim=(0, None))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend()
    return figure


def _cost_plot(cost: list[dict[str, Any]]) -> Figure:
    """Seconds per view and in all over the number of views."""
    figure = Figure(figsize=(4.5, 3.4), layout="constrained")
    axes = figure.subplots()
    count = [row["views"] for row in cost]
    for column in ("seconds", "per view"):
        axes.loglog(count, [row[column] for row in cost], "o-", label=column)
    axes.set(xlabel="views", ylabel="seconds")
    axes.set_xticks(count, map(str, count))
    axes.set_xticks([], minor=True)
    axes.legend()
    return figure


if __name__ == "__main__":
    main()
