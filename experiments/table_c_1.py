"""Table C.1: reprojection error of light fields without truth, from the center to the corner views.

    python experiments/table_c_1.py --scenes lytro/2067 --views 7 --out results/table_c_1
    python experiments/table_c_1.py --scenes STANFORD_FOLDER --views 17

Mean absolute difference of RGB x 100, as in the thesis, and the color difference in Lab; where a
view of a corner is missing, the ends of the crosshair take its place. `flat` has the mean of
the first map everywhere. The thesis' scenes are not part of the
development data, so that its figures are beside ours for their size alone.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from _depth import OURS, SWEEP, THESIS, Method, chain
from _model import first_map, run_self_supervised
from _published import published
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes
from table_7_2 import outermost

from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import reprojection_error
from mvedge_jax.plotting import plot_disparity


def optimized(light_field: LightField) -> jax.Array:
    """What `mvedge optimize` makes of our map: Chapter 7."""
    start = first_map(light_field)
    return run_self_supervised(start, light_field, raster=1, iterations=30)


METHODS = (
    OURS, chain("edges", preset="edges"), THESIS, SWEEP, Method("optimized", optimized),
)  # fmt: skip


def main() -> None:
    """Scores every method on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/table_c_1"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["lytro/2067"])
    parser.add_argument("--size", type=int, default=256, help="side of rendered scenes, px")
    parser.add_argument("--views", type=int, default=7, help="use the central VIEWS x VIEWS only")
    known = {method.name: method for method in METHODS}
    parser.add_argument("--methods", nargs="+", choices=list(known), default=list(known))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        field = light_field.without_truth().crop_views(arguments.views)
        maps = [known[method].run(field) for method in arguments.methods]
        flat = jnp.full_like(maps[0], jnp.mean(maps[0]))
        for method, disparity in zip((*arguments.methods, "flat"), (*maps, flat), strict=True):
            score = partial(reprojection_error, disparity, field, targets=outermost(field))
            rgb, lab = float(score(space="rgb").error), float(score(space="lab").error)
            rows.append({"scene": name, "method": method, "RGB x 100": rgb, "Lab": lab})
        plot_disparity(maps, names=arguments.methods).savefig(arguments.out / f"{name}.png")
        print_table([row for row in rows if row["scene"] == name], title=name)
        write_csv(arguments.out / "table_c_1.csv", rows)
        write_json(arguments.out / "table_c_1.json", rows)
    print_table(published("C.1"), title="thesis, Tab. C.1")


if __name__ == "__main__":
    main()
