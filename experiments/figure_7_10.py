"""Figure 7.10: supervised optimization over iterations (error against bytes: `codec.py`).

python experiments/figure_7_10.py --data ../shared/data --scenes hci/cotton
python experiments/figure_7_10.py --scenes edges slanted --size 512
"""

import argparse
from pathlib import Path

import jax
from _model import first_map, plain, printer, run_supervised
from _report import print_table, shared_data, write_csv, write_json
from _scenes import find_scene
from matplotlib.figure import Figure

from mvedge_jax.lightfield import LightField
from mvedge_jax.model.optimization import Growth

COLUMNS = {
    "mse": "MSE $\\times$ 100",
    "bad_01": "BadPix(0.01), %",
    "bad_03": "BadPix(0.03), %",
    "bad_07": "BadPix(0.07), %",
}


def curve(name: str, light_field: LightField, arguments: argparse.Namespace) -> list[dict]:
    """Scores over the iterations: by gradients alone, with points recycled, with more of them.

    All runs start from the detected points, and the first two keep their number.
    """
    start = plain(first_map(light_field), light_field.center_view)
    rows: list[dict] = []
    pixels = light_field.views.shape[2] * light_field.views.shape[3]
    added = int(arguments.grow * pixels)
    runs = {"gradients alone": None, "recycled": Growth()}
    if added:
        runs[f"{added} points added"] = Growth(extra=added)
    for run, strategy in runs.items():
        print(f"{name}, {run}: from {int(start.model.valid.sum())} detected points", flush=True)
        run_supervised(
            start,
            light_field,
            raster=arguments.raster,
            iterations=arguments.iterations,
            strategy=strategy,
            look=printer(f"{name}, {run}", light_field, rows),
        )
    return rows


def main() -> None:
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["hci/cotton"])
    parser.add_argument("--iterations", type=int, default=150)
    parser.add_argument("--grow", type=float, default=0.07, help="points to add per pixel")
    parser.add_argument("--size", type=int, default=128, help="of synthetic views, px")
    parser.add_argument("--raster", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("results/figure_7_10"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.scenes:
        light_field = find_scene(name, arguments.data, size=arguments.size)
        stem = name.replace("/", "_")
        rows = curve(name, light_field, arguments)
        print_table(rows, title="Figure 7.10")
        write_csv(arguments.out / f"{stem}.csv", rows)
        write_json(arguments.out / f"{stem}.json", rows)
        figure = Figure(figsize=(9, 3), layout="constrained")
        panels = figure.subplots(1, 4)
        for axes, (column, title) in zip(panels, COLUMNS.items(), strict=True):
            for run in dict.fromkeys(row["run"] for row in rows):
                mine = [row for row in rows if row["run"] == run]
                axes.semilogy([r["iteration"] for r in mine], [r[column] for r in mine], label=run)
            axes.set_title(title)
            axes.set_xlabel("iteration")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        figure.savefig(arguments.out / f"{stem}.png")
        # Programs of the whole chain take 1300 memory maps each; Linux allows 65530.
        jax.clear_caches()


if __name__ == "__main__":
    main()
