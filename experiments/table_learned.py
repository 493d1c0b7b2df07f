"""Preset `learned` beside `full`, on scenes that nothing was learned from.

*full*: numbers set by hand. *learned*: numbers and the network that `learned_preset.py` learned
from random scenes, as they come with the package. Files of other seeds are rows of their own.
MSE x 100, Q25 and the share of pixels that are off by more than .01, .03 and .07 px, full frame.

    python experiments/table_learned.py --out results/table_learned
    python experiments/table_learned.py results/learned_preset/seed_1.npz --scenes cotton
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._depth import Method, chain, score
from experiments._report import print_table, shared_data, write_csv, write_json
from experiments._scenes import DEVELOPMENT, find_scene, stored
from experiments.table_edges import COLUMNS, searched, summary
from mvedge_jax import EdgeDepth
from mvedge_jax.datasets import synthetic
from mvedge_jax.lightfield import LightField

RANGE = (-1.6, 1.6)  # px; one program for all scenes within it that have one size


def _of_file(path: Path) -> Method:
    """The chain with the values of a file that `learned_preset.py` wrote."""
    with np.load(path) as file:
        values = {name: np.asarray(file[name], np.float32) for name in file.files}

    def run(light_field: LightField) -> jax.Array:
        model = EdgeDepth.for_light_field(light_field, preset="learned").replace(values)
        return model(light_field).disparity

    return Method(path.stem.replace("_", " "), run)


def main() -> None:
    """Runs every method on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("values", type=Path, nargs="*", help="files of `learned_preset.py`")
    parser.add_argument("--out", type=Path, default=Path("results/table_learned"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[], help="by name; all 14 if none")
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    arguments = parser.parse_args()
    methods = [chain("full"), chain("learned", preset="learned"), *map(_of_file, arguments.values)]
    there = [name for name in (*DEVELOPMENT, "vinyl") if stored(name, arguments.data)]
    names = arguments.scenes or [*there, *synthetic.scene_names()]
    rows: list[dict[str, Any]] = []
    for name in names:
        light_field = searched(find_scene(name, arguments.data, size=arguments.size), RANGE)
        blind = light_field.without_truth()
        for method in methods:
            row = score(name, method, light_field, 0.0, method.run(blind))
            rows.append({key: row[key] for key in ("scene", "method", *COLUMNS)})
        print_table([row for row in rows if row["scene"] == name], title=name)
        # After every scene: a run that is stopped leaves what it has.
        table = {"rows": rows, "summary": summary(rows)}
        write_json(arguments.out / "table_learned.json", table)
        write_csv(arguments.out / "table_learned.csv", [*rows, *table["summary"]])
        if light_field.disparity_range is not None and not np.allclose(
            light_field.disparity_range, RANGE
        ):
            # Programs of its own: many of them exceed Linux' limit of memory maps.
            jax.clear_caches()
    print_table(summary(rows), title=f"over {len(names)} scenes")


if __name__ == "__main__":
    main()
