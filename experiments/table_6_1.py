"""Table 6.1: accuracy and time of the centre view's depth, with every baseline and ablation.

python experiments/table_6_1.py --out results/table_6_1
"""

import argparse
import time
from pathlib import Path

import cv2
import jax
import numpy as np
from _depth import ABLATIONS, EVERY, OURS, SPARSE, SWEEP, THESIS, as_image, score
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes

# Thesis, Tab. 6.1 and REFERENCE_NOTES 23 (the authors' code, run by us); full frame.
PUBLISHED = (
    ("sideboard", "thesis", 1.03, 1.22, None, None, None, 35.5),
    ("dino", "thesis", 0.45, 0.85, None, None, None, 37.7),
    ("cotton", "thesis", 0.70, 0.74, 56.2, 18.0, 4.86, 34.0),
    ("boxes", "thesis", 7.52, 1.41, None, None, None, 34.3),
    ("cotton", "authors' code", 0.693, 0.585, 59.4, 20.2, 4.70, None),
    ("backgammon", "authors' code", 6.32, 0.490, 53.8, 16.6, 8.52, None),
)
COLUMNS = ("scene", "method", "MSE*100", "Q25*100", "BP(.01)", "BP(.03)", "BP(.07)", "seconds")


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
        here: list[dict] = [{k: row[k] for k in COLUMNS} for row in rows if row["scene"] == name]
        published: list[dict] = [
            dict(zip(COLUMNS, row, strict=True)) for row in PUBLISHED if row[0] == name
        ]
        print_table(here + published, title=f"{name}: full frame")
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
