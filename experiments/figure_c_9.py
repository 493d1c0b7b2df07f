"""Figure C.9: 100, 75 and 50 % of the points.

python experiments/figure_c_9.py --data ../shared/data --scene hci/cotton
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
from _model import (
    first_map,
    plain,
    printer,
    run_self_supervised,
    run_supervised,
    scores,
)
from _report import print_table, shared_data, write_csv, write_json
from _scenes import find_scene


def main() -> None:
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scene", default="hci/cotton")
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--raster", type=int, default=1)
    parser.add_argument("--share", type=float, nargs="+", default=[1.0, 0.75, 0.5])
    parser.add_argument("--self-supervised", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("results/figure_c_9"))
    arguments = parser.parse_args()
    light_field = find_scene(arguments.scene, arguments.data, size=128)
    start = first_map(light_field)
    if not arguments.self_supervised:
        start = plain(start, light_field.center_view)
    run = run_self_supervised if arguments.self_supervised else run_supervised
    order = jax.random.uniform(jax.random.key(2), (start.model.valid.size,))
    rows, curve = [], []
    for share in arguments.share:
        kept = start.model.valid & (order < share)
        look = printer(f"{100 * share:g} %", light_field, curve)
        model = eqx.tree_at(lambda m: m.valid, start.model, kept)
        after = run(
            start._replace(model=model), light_field,
            raster=arguments.raster, iterations=arguments.iterations, look=look,
        )  # fmt: skip
        rows.append({"points": int(kept.sum()), **scores(after, light_field)})
    print_table(rows, title="Figure C.9")
    write_csv(arguments.out / "points.csv", rows)
    write_csv(arguments.out / "curve.csv", curve)
    write_json(arguments.out / "points.json", rows)


if __name__ == "__main__":
    main()
