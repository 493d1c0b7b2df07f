"""What each choice that the thesis leaves open, or that its program makes otherwise, costs.

Preset `thesis` has the steps of Chapters 4 and 6 as printed and corrected. Each row changes one of
them; `authors` is the chain as their program has it (`experiments/peers/authors.py`). MSE x 100,
Q25 and the share of pixels that are off by more than .01, .03 and .07 px, full frame.

    python experiments/thesis_steps.py --out results/thesis_steps
    python experiments/thesis_steps.py --scenes edges thin --size 128 --only thesis authors
"""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import jax

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._depth import THESIS, Method, chain, score
from experiments._report import print_table, shared_data, write_csv, write_json
from experiments._scenes import find_scene
from experiments.peers.authors import authors_model
from mvedge_jax._params import as_number
from mvedge_jax.depth import NearestLabels, PointWeight, StepWeight
from mvedge_jax.edges.sides import NoSides, ThesisSides
from mvedge_jax.lightfield import LightField
from mvedge_jax.smoothness import ColorAndDepth, ImageGradient

COLUMNS = ("MSE*100", "Q25*100", "BP(.01)", "BP(.03)", "BP(.07)")


def but(name: str, parts: dict[str, Any] | None = None, **choices: Any) -> Method:
    """Preset `thesis` with other parts, and with choices whose dots are written as `__`."""
    made = {part: lambda _, value=value: value for part, value in (parts or {}).items()}
    paths = {path.replace("__", "."): value for path, value in choices.items()}
    return chain(name, made, preset="thesis", choices=paths)


def authors(light_field: LightField) -> jax.Array:
    """The map of the authors' chain."""
    return authors_model(light_field)(light_field, key=jax.random.key(0)).disparity


METHODS = (
    THESIS,
    but("Alg. 1: responses modulated", edges__lines__modulate=True),
    but("Alg. 1: between filters", edges__lines__interpolate=True),
    but("4.1.3: no vote", edges__lines__vote=False),
    but("4.1.4: one scale", edges__lines__levels=1),
    but("4.3: four views in a row", edges__lines__alignment="run"),
    but("4.4: crossed lines alone are tested", edges__lines__visibility="crossed"),
    but("4.5: no entropy search", edges__lines__entropy=False),
    but("4.6: in sRGB, 5 px", edges__color="srgb", edges__space_sigma=5.0),
    but("4.6: no joint filter", edges__joint=False),
    but("4.11: squared gradient", {"sides": ThesisSides(stretched=False)}),
    but("4.2.2: no sides", {"sides": NoSides()}),
    # Weights are relative to the largest one.
    but(
        "6.3: exponent up to 8",
        {"labels": NearestLabels(StepWeight(limit=as_number(8.0)))},
        refine__stiffness=1.5 * math.exp(-4),
    ),
    but("6.3: standard errors, too", {"labels": NearestLabels(PointWeight())}),
    but("6.1: smoothness by the image", {"smoothness": ImageGradient()}),
    but("6.1: by color and depth, twice", {"smoothness": ColorAndDepth()}, refine__solves=2),
    but("6.1: quantized median", refine__sharpen__mode="quantized", refine__sharpen__levels=256),
    but("6.1: no median", refine__sharpen__mode="none"),
    Method("authors", authors),
)


def main() -> None:
    """Runs the rows on the scenes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/thesis_steps"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=["cotton"], help="by name")
    parser.add_argument("--only", nargs="*", default=[], help="rows, by how they begin")
    parser.add_argument("--size", type=int, default=256, help="side of rendered scenes, px")
    arguments = parser.parse_args()
    chosen = tuple(arguments.only) or ("",)
    methods = [method for method in METHODS if method.name.startswith(chosen)]
    rows: list[dict[str, Any]] = []
    for name in arguments.scenes:
        light_field = find_scene(name, arguments.data, size=arguments.size)
        for method in methods:
            row = score(name, method, light_field, 0.0, method.run(light_field.without_truth()))
            rows.append({key: row[key] for key in ("scene", "method", *COLUMNS)})
            # Nearly every row is a program of its own.
            jax.clear_caches()
            write_json(arguments.out / "thesis_steps.json", rows)
        print_table([row for row in rows if row["scene"] == name], title=name)
    write_csv(arguments.out / "thesis_steps.csv", rows)


if __name__ == "__main__":
    main()
