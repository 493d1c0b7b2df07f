"""Chapter 7 as printed, on a light field: edge points, splatted, diffused, optimized in turns.

    python experiments/chapter_7.py --scenes hci/cotton --out results/chapter_7
    python experiments/chapter_7.py --scenes hci/cotton --vgg16 vgg16.npz

Points of preset `thesis` on the sides of their edges, all of weight 1; Q from the image gradient.
There is no dense map to start from: the first one is what the points render. The loss is (7.16)
over all views of the crosshair, in RGB, or in features of VGG16 where a file of its weights is
given (`losses.features.load_vgg16`). Q, Z, R and xy take turns of 13 iterations, 5 times. The map
is that of the lowest loss, whatever other views say of it. `printed` has points of the thesis'
width, 8 samples along the ray, labels that are not divided by their coverage, and points that hide
others whatever they weigh; `narrow` has the package's renderer. `preset thesis` is Chapter 6. For
one light field, `mvedge optimize --preset thesis --loss printed` does the same.
"""

import argparse
from pathlib import Path
from typing import Any

import jax
from _model import printer, scores
from _published import published
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes
from matplotlib.figure import Figure

from mvedge_jax.depth import DepthResult, EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses.features import Colors, load_vgg16
from mvedge_jax.losses.terms import Features
from mvedge_jax.model import Renderer, optimize_edges, start_from_edges
from mvedge_jax.model.approaches import ByReprojection
from mvedge_jax.model.optimization import Rates, one_at_a_time
from mvedge_jax.plotting import plot_comparison

RENDERERS = {"printed": Renderer.thesis(), "narrow": Renderer.on_raster(1)}


def optimized(
    light_field: LightField,
    depth: DepthResult,
    renderer: Renderer,
    features: Features,
    arguments: argparse.Namespace,
    look: Any,
) -> tuple[jax.Array, jax.Array]:
    """The map that the points render, and that of the lowest loss."""
    start = start_from_edges(light_field, depth, renderer)
    routine = one_at_a_time(Rates(), iterations=arguments.iterations, passes=arguments.passes)
    approach = ByReprojection.thesis(features)
    found = optimize_edges(light_field, start, approach, renderer, routine=routine, progress=look)
    return start.disparity, found.disparity


def main() -> None:
    """Optimizes every scene with every renderer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/chapter_7"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["edges"])
    parser.add_argument("--size", type=int, default=256, help="side of rendered scenes, px")
    parser.add_argument("--iterations", type=int, default=13, help="per parameter and pass")
    parser.add_argument("--passes", type=int, default=5)
    parser.add_argument("--vgg16", type=Path, help="an .npz file of VGG16's first convolutions")
    parser.add_argument("--renderers", nargs="+", choices=list(RENDERERS), default=list(RENDERERS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    features = Colors() if arguments.vgg16 is None else load_vgg16(arguments.vgg16)
    rows: list[dict[str, Any]] = []
    curve: list[dict[str, Any]] = []
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        blind, truth = light_field.without_truth(), light_field.truth
        assert truth is not None
        thesis = EdgeDepth.for_light_field(blind, preset="thesis")
        result = thesis(blind, key=jax.random.key(0))
        maps = {"preset thesis": result.disparity}
        for kind in arguments.renderers:
            look = printer(f"{name}, {kind}", light_field, curve)
            renderer = RENDERERS[kind]
            before, after = optimized(blind, result, renderer, features, arguments, look)
            maps |= {f"{kind}, start": before, f"{kind}, optimized": after}
        here: list[dict[str, Any]] = [
            {"scene": name, "map": kind, **scores(disparity, light_field)}
            for kind, disparity in maps.items()
        ]
        rows += here
        print_table(here, title=name)
        print_table(published("7.2", scene=Path(name).name), title=f"thesis, Tab. 7.2: {name}")
        captions = [f"MSE x 100: {row['mse']:.2f}" for row in here]
        compared = plot_comparison(
            list(maps.values()), truth.disparity, names=list(maps), captions=captions, width=12
        )  # fmt: skip
        compared.savefig(arguments.out / f"{name}.png")
        write_csv(arguments.out / "chapter_7.csv", rows)
        write_json(arguments.out / "chapter_7.json", {"rows": rows, "curve": curve})
        _plot(curve).savefig(arguments.out / "figure_7_7.png")


def _plot(curve: list[dict[str, Any]]) -> Figure:
    """Errors over iterations, as in Figure 7.7."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    for axes, column in zip(figure.subplots(1, 3), ("mse", "bad_01", "bad_07"), strict=True):
        for run in dict.fromkeys(row["run"] for row in curve):
            mine = [row for row in curve if row["run"] == run]
            axes.plot([r["iteration"] for r in mine], [r[column] for r in mine], "o-", label=run)
        axes.set(title=column, xlabel="iteration", ylim=(0, None))
    figure.axes[0].legend(fontsize=7)
    return figure


if __name__ == "__main__":
    main()
