"""Figures A.1 to A.3: weights of color, position and disparity in the clustering, scene by scene.

    python experiments/figure_a_1.py --scenes edges demo --out results/figure_a_1

Every weight of a method is multiplied by the factors, one at a time: of k-means with our disparity
and with the true one, of the thesis' clustering of EPI segments, and of ours. Ours has scales in
the place of weights: a larger weight is a smaller scale, and a larger weight of the position is a
larger scale of the two others. One picture per scene and weight, six metrics in the authors' forms.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from _report import print_table, shared_data, write_csv, write_json
from _superpixels import PUBLISHED
from figure_5_4 import TRUE, AnyParams, case_of, cut, score
from matplotlib.figure import Figure
from peers.kmeans import KMeansParams
from peers.lfsp import LfspParams

from mvedge_jax.superpixels import SuperpixelClustering

# By weight: the thesis' figure.
FIGURES = {"color": "a_1", "position": "a_2", "disparity": "a_3"}
METHODS = ("ours", "thesis", "k-means", TRUE)


def weighted(method: str, weight: str, factor: float, size: float) -> AnyParams:
    """Parameters of a method with one of its weights multiplied."""
    if method != "ours":
        kind = LfspParams() if method == "thesis" else KMeansParams()
        return replace(kind, **{weight: factor * getattr(kind, weight)})
    # For the defaults of its numbers.
    kind = SuperpixelClustering(capacity=1, margin=0)
    scales = {"color": kind.color, "depth": kind.depth}
    name = {"disparity": "depth"}.get(weight, weight)
    if name in scales:
        return {"size": size, name: scales[name] / factor}
    return {"size": size, **{name: factor * scale for name, scale in scales.items()}}


def main() -> None:
    """Sweeps every weight of every method on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/figure_a_1"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["edges", "demo"])
    parser.add_argument("--pixels", type=int, default=256, help="side of rendered scenes, px")
    parser.add_argument("--size", type=float, default=20.0, help="of a superpixel, px")
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--factors", type=float, nargs="+", default=[0.25, 0.5, 1.0, 2.0, 4.0])
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for name in arguments.scenes:
        case = case_of(arguments, name, 1)
        for weight in FIGURES:
            for method in arguments.methods:
                for factor in arguments.factors:
                    chosen = weighted(method, weight, factor, arguments.size)
                    labels = cut(method, case, arguments.size, chosen)
                    key = {"scene": name, "weight": weight, "method": method, "factor": factor}
                    rows.append({**key, **score(labels, case)})
            here = [row for row in rows if row["scene"] == name and row["weight"] == weight]
            picture = _plot(here, f"{name}: weight of {weight}, times")
            picture.savefig(arguments.out / f"figure_{FIGURES[weight]}_{Path(name).name}.png")
            shown = ("method", "factor", *PUBLISHED)
            print_table([{k: row[k] for k in shown} for row in here], title=f"{name}, {weight}")
        # After every scene: a run that is stopped leaves what it has.
        write_csv(arguments.out / "figure_a_1.csv", rows)
        write_json(arguments.out / "figure_a_1.json", rows)
        jax.clear_caches()


def _plot(rows: list[dict[str, Any]], title: str) -> Figure:
    """Six metrics over the factor, a curve per method."""
    figure = Figure(figsize=(11, 6.5), layout="constrained")
    for axes, name in zip(figure.subplots(2, 3).ravel(), PUBLISHED, strict=True):
        for method in dict.fromkeys(row["method"] for row in rows):
            mine = [row for row in rows if row["method"] == method]
            values = np.asarray([row[name] for row in mine])
            axes.semilogx([row["factor"] for row in mine], values, "o-", label=method)
        axes.set(title=name.replace("_", " "))
        axes.axvline(1.0, color="0.6", linewidth=0.8)
        factors = sorted({row["factor"] for row in rows})
        axes.set_xticks(factors, [f"{factor:g}" for factor in factors])
        axes.set_xticks([], minor=True)
    figure.axes[0].legend(fontsize=7)
    figure.supxlabel(title)
    return figure


if __name__ == "__main__":
    main()
