"""A contact sheet of random scenes: center views and their true disparity, and what they cost.

python experiments/random_scenes.py --out results/random_scenes
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro
from _report import print_table, write_json
from matplotlib.figure import Figure

from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic import random_scenes
from mvedge_jax.lightfield import LightField


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        count: scenes on the sheet.
        size: side of the views, px.
        views: views along a side of the grid; odd.
        split: of the scenes.
        seed: of their key.
        out: folder for the sheet and the times.
    """

    count: int = 32
    size: int = 128
    views: int = 3
    split: Literal["train", "validation", "test"] = "train"
    seed: int = 0
    out: Path = Path("results/random_scenes")


def main() -> None:
    """Renders and draws."""
    arguments = tyro.cli(Arguments, description=__doc__)
    shape = (arguments.views, arguments.views, arguments.size, arguments.size)
    fields, rows = [], []
    for number in range(arguments.count):
        key = jax.random.fold_in(jax.random.key(arguments.seed), number)
        start = time.perf_counter()
        scene = random_scenes.random_scene(split=arguments.split, key=key)
        field = synthetic.render(scene, shape=shape, samples=2, key=key)
        fields.append(field)
        low, high = np.asarray(scene.disparity_range).tolist()
        solids = int(scene.world.solids.count)
        seconds = time.perf_counter() - start
        rows.append({"low": low, "high": high, "solids": solids, "seconds": seconds})
    print_table(rows, title="random scenes")
    write_json(arguments.out / "random_scenes.json", {"scenes": rows})
    _sheet(fields).savefig(arguments.out / "random_scenes.png", dpi=110)


def _sheet(fields: list[LightField], columns: int = 8) -> Figure:
    """Pairs of a center view and its disparity below it."""
    rows = -(-len(fields) // columns)
    figure = Figure(figsize=(1.7 * columns, 3.4 * rows), layout="constrained")
    axes = figure.subplots(2 * rows, columns, squeeze=False)
    for axis in axes.ravel():
        axis.set_axis_off()
    for number, field in enumerate(fields):
        row, column = divmod(number, columns)
        assert field.truth is not None
        disparity = np.asarray(field.truth.disparity)
        axes[2 * row, column].imshow(np.asarray(field.center_view))
        axes[2 * row, column].set_title(str(number), fontsize=6)
        axes[2 * row + 1, column].imshow(disparity, cmap="turbo")
        text = f"{disparity.min():.2f} .. {disparity.max():.2f} px"
        axes[2 * row + 1, column].set_title(text, fontsize=6)
    return figure


if __name__ == "__main__":
    main()
