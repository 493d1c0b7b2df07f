"""Table 6.2: how the side of every edge is chosen, and what it is worth.

Bidirectional diffusion against the reprojection error of the two maps and against no surface
vectors at all (Fig. B.1), with edge labels alone, as in the thesis; the last column has dense
labels as well.

    python experiments/table_6_2.py --out results/table_6_2
"""

import argparse
from pathlib import Path

from _depth import OURS, SPARSE, score
from _published import published
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes


def main() -> None:
    """Runs the choices of side on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/table_6_2"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    arguments = parser.parse_args()
    rows, table = [], []
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        blind = light_field.without_truth()
        found = [score(name, m, light_field, 0.0, m.run(blind)) for m in (*SPARSE, OURS)]
        rows += found
        ours, thesis, reprojection, naive, dense = (row["MSE*100"] for row in found)
        table.append(
            {
                "scene": name,
                "MSE bidirectional": ours,
                "MSE thesis' response": thesis,
                "MSE reprojection": reprojection,
                "MSE naive": naive,
                "best": "bidirectional" if ours < min(reprojection, naive) else "a baseline",
                "MSE with dense labels": dense,
            }
        )
    print_table(table, title="MSE*100, full frame")
    print_table(published("6.2"), title="thesis, Tab. 6.2")
    write_csv(arguments.out / "table_6_2.csv", table)
    write_json(arguments.out / "table_6_2.json", rows)


if __name__ == "__main__":
    main()
