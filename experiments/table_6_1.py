"""Table 6.1: accuracy and time of the center view's depth, with every baseline and ablation.

What the thesis prints, what the authors' program scores and, where their maps are there, what
others score (`peer_maps.py`) stands beside ours.

python experiments/table_6_1.py --out results/table_6_1
"""

import argparse
import time
from pathlib import Path
from typing import Any

import cv2
import jax
import numpy as np
from _depth import ABLATIONS, EVERY, OURS, SPARSE, SWEEP, THESIS, as_image, score
from _published import authors_program, published
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes
from peer_maps import peer_rows

from mvedge_jax.lightfield import GroundTruth

COLUMNS = ("scene", "method", "MSE*100", "Q25*100", "BP(.01)", "BP(.03)", "BP(.07)", "seconds")


def others(data: Path | None, scene: str, truth: GroundTruth) -> list[dict[str, Any]]:
    """Rows of a scene that are not ours."""
    rows = [*published("6.1", scene=scene), *published("7.2", scene=scene)]
    thesis = [{**row, "method": f"thesis: {row['method']}"} for row in rows]
    peers = [
        {**row, "method": f"{row['method']}, without {row['margin px']} px of border"}
        if row["margin px"]
        else row
        for row in peer_rows(data, scene, truth)
    ]
    return [*thesis, *authors_program(scene=scene), *peers]


def main() -> None:
    """Runs every method on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/table_6_1"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    parser.add_argument("--ablations", action="store_true", help="every form of every step too")
    known = {method.name: method for method in (OURS, EVERY, *SPARSE, THESIS, SWEEP)}
    parser.add_argument("--methods", nargs="+", choices=known, default=list(known))
    arguments = parser.parse_args()
    chosen = [known[name] for name in arguments.methods]
    methods = (*chosen, *(ABLATIONS if arguments.ablations else ()))
    rows = []
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        blind, truth = light_field.without_truth(), light_field.truth
        if truth is None:
            raise ValueError(f"scene {name} has no ground truth to score against.")
        for method in methods:
            jax.block_until_ready(method.run(blind))
            start = time.perf_counter()
            disparity = jax.block_until_ready(method.run(blind))
            rows.append(score(name, method, light_field, time.perf_counter() - start, disparity))
            picture = arguments.out / f"{name}_{method.name.replace(' ', '_')}.png"
            picture.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(picture), as_image(disparity, truth.disparity))
        here = [row for row in rows if row["scene"] == name]
        shown = [*here, *others(arguments.data, name, truth)]
        table = [{column: row.get(column) for column in COLUMNS} for row in shown]
        print_table(table, title=f"{name}: full frame")
        # After every scene: a run that is stopped leaves what it has.
        write_csv(arguments.out / "table_6_1.csv", rows)
        write_json(arguments.out / "table_6_1.json", rows)
    averages: list[dict] = []
    for method in methods:
        mine = [row for row in rows if row["method"] == method.name]
        mean = {c: float(np.mean([row[c] for row in mine])) for c in COLUMNS[2:]}
        averages.append({"scene": "average", "method": method.name, **mean})
    print_table(averages, title="average over the scenes above")


if __name__ == "__main__":
    main()
