"""Table 6.3 and Figure 6.4: precision and recall of depth boundaries.

python experiments/table_6_3.py --out results/table_6_3
"""

import argparse
from pathlib import Path

from _depth import OURS, SPARSE, SWEEP
from _published import published
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes

from mvedge_jax.metrics import boundary_scores
from mvedge_jax.plotting import plot_precision_recall

COLUMNS = ("method", "mean F1", "peak F1", "AUC")


def main() -> None:
    """Scores the boundaries of every method on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/table_6_3"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    methods = (OURS, SPARSE[0], SPARSE[-1], SWEEP)
    rows = []
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        truth, blind = light_field.truth, light_field.without_truth()
        assert truth is not None
        curves = [boundary_scores(m.run(blind), truth.disparity, mask=truth.valid) for m in methods]
        for method, curve in zip(methods, curves, strict=True):
            values = (curve.mean_f1, curve.peak_f1, curve.auc)
            row = dict(zip(COLUMNS, (method.name, *map(float, values)), strict=True))
            rows.append({"scene": name, **row})
        print_table([row for row in rows if row["scene"] == name], title=name)
        figure = plot_precision_recall(curves, names=[m.name for m in methods])
        figure.savefig(arguments.out / f"figure_6_4_{name}.png")
    # Compare the order alone: the thesis does not print its tolerance.
    print_table(published("6.3"), title="thesis, Tab. 6.3, ten times the scores")
    write_csv(arguments.out / "table_6_3.csv", rows)
    write_json(arguments.out / "table_6_3.json", rows)


if __name__ == "__main__":
    main()
