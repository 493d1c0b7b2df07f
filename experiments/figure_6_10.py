"""Figure 6.10: error against hyperparameters, every sweep one compiled program under `vmap`.

    python experiments/figure_6_10.py --scenes edges --size 128 --out results/figure_6_10
    python experiments/figure_6_10.py --preset full

Preset `thesis` has the thesis' own eight. Each is multiplied by 1/4 to 4, t by what it leaves of 1.
Scenes are searched over the widest of their ranges, so that they share a program.
"""

import argparse
import time
from pathlib import Path

import jax
import jax.numpy as jnp
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes
from jax import Array
from matplotlib.figure import Figure

from mvedge_jax import describe, lean_jit
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.learn import of_one_range
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.metrics.depth import mse, q25

# Numbers by path, and what the thesis calls them.
SWEEPS = {
    "thesis": {
        "edges.lines.aligned": "k, of the views",
        "edges.lines.aligned_angle": "τ_f, rad",
        "edges.lines.visible_angle": "τ_v, rad",
        "edges.lines.decay": "t",
        "edges.lines.amplitude": "α, px",
        "edges.space_sigma": "σ_s, px",
        "edges.disparity_sigma": "σ_d, px",
        "edges.color_sigma": "σ_c, CIELAB",
    },
    "full": {
        path: path
        for path in (
            *("refine.precision", "refine.stiffness", "labels.weight", "dense.trust"),
            *("smoothness.color", "smoothness.depth", "measurement.drift"),
            *("calibration.matching.truncation", "calibration.matching.drift"),
            *("refine.sharpen.slack", "edges.error_limit"),
        )
    },
}


@lean_jit
def _errors(settings: EdgeDepth, blind: LightField, truth: GroundTruth) -> tuple[Array, Array]:
    """MSE and Q25 of every setting. All numbers are batched: one program serves every sweep."""

    def one(model: EdgeDepth) -> tuple[Array, Array]:
        found = model(blind, key=jax.random.key(0)).disparity
        maps = found, truth.disparity
        return mse(*maps, mask=truth.valid), q25(*maps, mask=truth.valid)

    return jax.vmap(one)(settings)


def main() -> None:
    """Sweeps one parameter at a time around its default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/figure_6_10"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["edges"])
    parser.add_argument("--size", type=int, default=128, help="side of the rendered scenes, px")
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--preset", choices=list(SWEEPS), default="thesis")
    parser.add_argument(
        "--only", nargs="*", default=[], help="numbers to sweep, by path; all if none"
    )
    arguments = parser.parse_args()
    factors = jnp.geomspace(0.25, 4.0, arguments.steps)
    rows = []
    found_scenes = dict(scenes(arguments.data, arguments.scenes, size=arguments.size))
    ranged = of_one_range(list(found_scenes.values()))
    base = EdgeDepth.for_light_field(ranged[0].without_truth(), preset=arguments.preset)
    known = {row.path: row.value for row in describe(base)}
    for name, light_field in zip(found_scenes, ranged, strict=True):
        truth, blind = light_field.truth, light_field.bare()
        assert truth is not None
        for label, title in SWEEPS[arguments.preset].items():
            if arguments.only and label not in arguments.only:
                continue
            value = known[label]
            values = 1 - factors * (1 - value) if label.endswith("decay") else factors * value
            settings = jax.tree.map(lambda a: jnp.stack([a] * arguments.steps), base)
            settings = settings.replace({label: values})
            start = time.perf_counter()
            found = jax.block_until_ready(_errors(settings, blind, truth))
            seconds = time.perf_counter() - start
            for value, m, q in zip(values, *found, strict=True):
                row = {"value": float(value), "MSE*100": float(m), "Q25*100": float(q)}
                rows.append({"scene": name, "parameter": title, **row, "seconds": seconds})
        print_table([row for row in rows if row["scene"] == name], title=name)
    write_csv(arguments.out / "figure_6_10.csv", rows)
    write_json(arguments.out / "figure_6_10.json", rows)
    _plot(rows).savefig(arguments.out / "figure_6_10.png")


def _plot(rows: list[dict]) -> Figure:
    """One panel per parameter: error over the value, the mean over the scenes."""
    labels = list(dict.fromkeys(row["parameter"] for row in rows))
    figure = Figure(figsize=(12, 2.6 * -(-len(labels) // 4)), layout="constrained")
    axes = figure.subplots(-(-len(labels) // 4), 4, squeeze=False).ravel()
    for axis, label in zip(axes, labels, strict=False):
        here = [row for row in rows if row["parameter"] == label]
        values = sorted({row["value"] for row in here})
        for column in ("MSE*100", "Q25*100"):
            means = []
            for value in values:
                found = [row[column] for row in here if row["value"] == value]
                means.append(sum(found) / len(found))
            axis.plot(means, "o-", label=column)
        # What the preset has; the thesis' figure marks it, too.
        axis.axvline(len(values) // 2, color="0.6", linewidth=0.8)
        axis.set(title=label, ylim=(0, None))
        # Equal steps are equal factors.
        axis.set_xticks(range(len(values)), [f"{value:.2g}" for value in values])
    for axis in axes[len(labels) :]:
        axis.set_axis_off()
    axes[0].legend()
    return figure


if __name__ == "__main__":
    main()
