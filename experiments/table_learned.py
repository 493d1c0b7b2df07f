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

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._depth import Method, chain
from experiments._report import shared_data, write_csv, write_json
from experiments._scenes import DEVELOPMENT, stored
from experiments.table_edges import compare
from mvedge_jax import EdgeDepth
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth.solves import LearnedLabels
from mvedge_jax.lightfield import LightField


def _of_file(path: Path) -> Method:
    """Preset `full` with the values of a file that `learned_preset.py` wrote."""
    with np.load(path) as file:
        values = {name: np.asarray(file[name], np.float32) for name in file.files}

    def run(light_field: LightField) -> jax.Array:
        model = EdgeDepth.for_light_field(light_field)
        model = model.replace(dense=LearnedLabels.untrained(key=jax.random.key(0)))
        return model.replace(values)(light_field).disparity

    return Method(path.stem.replace("_", " "), run)


def main() -> None:
    """Compares the presets, and files of other runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("values", type=Path, nargs="*", help="files of `learned_preset.py`")
    parser.add_argument("--out", type=Path, default=Path("results/table_learned"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[], help="by name; all 14 if none")
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    arguments = parser.parse_args()
    there = [name for name in (*DEVELOPMENT, "vinyl") if stored(name, arguments.data)]
    tables = compare(
        [chain("full"), chain("learned", preset="learned"), *map(_of_file, arguments.values)],
        arguments.scenes or [*there, *synthetic.scene_names()],
        data=arguments.data,
        size=arguments.size,
    )
    for table in tables:
        write_json(arguments.out / "table_learned.json", table)
        write_csv(arguments.out / "table_learned.csv", [*table["rows"], *table["summary"]])


if __name__ == "__main__":
    main()
