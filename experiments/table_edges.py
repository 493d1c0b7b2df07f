"""What the edges are worth: parts taken away and put in, from the thesis' chain to the whole one.

*thesis*: Chapters 4 and 6. *edges*: the edges alone, splatted with transmittance. The same without
transmittance: every label on its nearest pixel; and without sides: labels stay on their edges.
*full*: with dense labels; and the same *without edges*, whose points have the weight 0. MSE x 100,
Q25 and the share of pixels that are off by more than .01, .03 and .07 px, full frame.

Scenes are searched over common ranges (`_scenes.RANGES`), so that those of one size share programs.

    python experiments/table_edges.py --out results/table_edges
    python experiments/table_edges.py --scenes cotton edges --size 128
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._depth import THESIS, Method, chain, score
from experiments._report import print_table, shared_data, write_csv, write_json
from experiments._scenes import (
    DEVELOPMENT,
    common_range,
    find_scene,
    over_common_range,
    stored,
)
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import NearestLabels
from mvedge_jax.edges.sides import NoSides

METHODS = (
    THESIS,
    chain("edges", preset="edges"),
    chain("edges without transmittance", {"labels": lambda _: NearestLabels()}, preset="edges"),
    chain("edges without sides", {"sides": lambda _: NoSides()}, preset="edges"),
    chain("full without edges", choices={"labels.weight": 0.0}),
    chain("full"),
)
COLUMNS = ("MSE*100", "Q25*100", "BP(.01)", "BP(.03)", "BP(.07)")


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The mean and the worst score of every method over the scenes."""
    found = []
    for name, over in (("mean", np.mean), ("worst", np.max)):
        for method in dict.fromkeys(row["method"] for row in rows):
            mine = [row for row in rows if row["method"] == method]
            scores = {column: float(over([row[column] for row in mine])) for column in COLUMNS}
            found.append({"scene": name, "method": method, **scores})
    return found


def compare(
    methods: Sequence[Method],
    names: Sequence[str],
    *,
    data: Path | None,
    size: int,
) -> Iterator[dict[str, Any]]:
    """Runs every method on every scene and prints the scores.

    Args:
        methods: rows of every scene.
        names: of the scenes, see `find_scene`.
        data: folder of development data.
        size: side of the rendered scenes, px.

    Yields:
        After every scene, the rows so far and their summary: a run that is stopped leaves these.
    """
    rows: list[dict[str, Any]] = []
    for name in names:
        light_field = over_common_range(find_scene(name, data, size=size))
        blind = light_field.without_truth()
        for method in methods:
            row = score(name, method, light_field, 0.0, method.run(blind))
            rows.append({key: row[key] for key in ("scene", "method", *COLUMNS)})
        print_table([row for row in rows if row["scene"] == name], title=name)
        yield {"rows": rows, "summary": summary(rows)}
        if common_range(light_field) is None:
            # Programs of its own: many of them exceed Linux' limit of memory maps.
            jax.clear_caches()
    print_table(summary(rows), title=f"over {len(names)} scenes")


def main() -> None:
    """Compares the presets and their parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/table_edges"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[], help="by name; all 13 if none")
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    arguments = parser.parse_args()
    there = [name for name in DEVELOPMENT if stored(name, arguments.data)]
    tables = compare(
        METHODS,
        arguments.scenes or [*there, *synthetic.scene_names()],
        data=arguments.data,
        size=arguments.size,
    )
    for table in tables:
        write_json(arguments.out / "table_edges.json", table)
        write_csv(arguments.out / "table_edges.csv", [*table["rows"], *table["summary"]])


if __name__ == "__main__":
    main()
