"""Time and memory of the center view's depth, stage by stage.

    python experiments/benchmarks/depth.py --scene SCENE --out results/benchmark_depth

Each stage is compiled and timed alone, on the inputs that the chain gives it; "all stages" is the
one program that `estimate_depth` is, so the sum differs from it by what XLA fuses. It is compiled
first and the compiler's memory given back before it runs. "first" is the sum of both.

`--calls` times what the README names, one after the other: presets, and the gradient.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import peak_memory, print_table, shared_data, timed, write_json

from mvedge_jax import describe, lean_jit
from mvedge_jax._crosshair import crosshair
from mvedge_jax.cli._common import compiled
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.depth import EdgeDepth, estimate_depth, multiview_edges
from mvedge_jax.diffusion import System, diffuse
from mvedge_jax.edges.sides import MapSides, surface_vectors
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Calibrate
from mvedge_jax.photometry.matching import hypotheses
from mvedge_jax.photometry.measuring import AdaptedMeasurement, CrosshairSplines, labels


def main() -> None:
    """Times the stages on one light field."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=None, help="default: cotton, or synthetic")
    parser.add_argument("--out", type=Path, default=Path("results/benchmark_depth"))
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--preset", choices=["full", "edges"], default="full")
    parser.add_argument("--only-all", action="store_true", help="the whole chain alone")
    parser.add_argument("--gradient", action="store_true", help="the chain and its derivatives")
    parser.add_argument("--calls", action="store_true", help="presets and gradient: times.json")
    parser.add_argument("--settings", action="store_true", help="`vmap` over settings instead")
    parser.add_argument("--all-views", action="store_true", help="labels from the whole grid")
    arguments = parser.parse_args()
    if arguments.settings:
        _settings(arguments.out, arguments.repeats)
        return
    data = shared_data()
    if arguments.scene is not None:
        light_field = load_light_field(arguments.scene)
    elif data is not None:
        light_field = load_light_field(data / "hci" / "cotton")
    else:
        light_field = synthetic.render(
            synthetic.scene("demo"), shape=(9, 9, 512, 512), key=jax.random.key(0)
        )
    light_field = light_field.without_truth()
    which = "all" if arguments.all_views else "crosshair"
    model = EdgeDepth.for_light_field(light_field, preset=arguments.preset, views=which)
    rows = []

    def measure(name, function, *inputs):
        start = time.perf_counter()
        if hasattr(function, "lower"):
            function = compiled(function, *inputs)
        compilation = time.perf_counter() - start
        result, timing = timed(function, *inputs, repeats=arguments.repeats)
        rows.append(
            {
                "stage": name,
                "first s": compilation + timing.first,
                "median s": timing.median,
                "best s": timing.best,
                "peak MiB": peak_memory() / 2**20,
            }
        )
        return result

    before = time.perf_counter()
    if arguments.calls:
        # In order of memory: the peak is that of the process so far.
        every = EdgeDepth.for_light_field(light_field, views="all")
        measure("full", estimate_depth, light_field, model)
        measure("all", estimate_depth, light_field, every)
        measure("gradient", _gradient, model, light_field)
        write_json(arguments.out / "times.json", rows)
        return
    measure("all stages", estimate_depth, light_field, model)
    if arguments.gradient:
        measure("value and gradient", _gradient, model, light_field)
    elif not arguments.only_all and arguments.preset == "full":
        _stages(measure, light_field, model)
    print_table(rows, title=f"{light_field.name}, {light_field.views.shape[:4]}")
    write_json(arguments.out / "depth.json", rows)
    print(f"{time.perf_counter() - before:.1f} s in all")


@lean_jit
def _gradient(model: EdgeDepth, light_field: LightField) -> Any:
    """A loss of the map with its gradient in the model and in every pixel of every view."""

    def loss(model: EdgeDepth, views: jax.Array) -> jax.Array:
        seen = eqx.tree_at(lambda f: f.views, light_field, views)
        return jnp.mean(jnp.sin(3 * model(seen).disparity))

    return jax.value_and_grad(loss, (0, 1))(model, light_field.views)


def _settings(out: Path, repeats: int) -> None:
    """Eight settings of two parameters: one `vmap` beside eight calls, a synthetic scene."""
    light_field = synthetic.render(
        synthetic.scene("demo"), shape=(9, 9, 96, 128), key=jax.random.key(0)
    ).without_truth()
    model = EdgeDepth.for_light_field(light_field)
    known = {row.path: row.value for row in describe(model)}

    def depth(precision, color):
        choices = {"refine.precision": precision, "smoothness.color": color}
        return model.replace(choices)(light_field).disparity

    one, two = known["refine.precision"], known["smoothness.color"]
    factors = jnp.linspace(0.5, 2.0, 8)
    settings = factors * one, factors[::-1] * two
    single, together = lean_jit(depth), lean_jit(jax.vmap(depth))

    def calls(first, second):
        return jnp.stack([single(a, b) for a, b in zip(first, second, strict=True)])

    apart, eight = timed(calls, *settings, repeats=repeats)
    batch, vmapped = timed(together, *settings, repeats=repeats)
    row = {
        "scene": "demo, 9x9 views of 96x128",
        "8 calls s": eight.median,
        "one vmap s": vmapped.median,
        "ratio": vmapped.median / eight.median,
        "max difference px": float(jnp.abs(apart - batch).max()),
        "share above 0.01 px": float((jnp.abs(apart - batch) > 0.01).mean()),
    }
    print_table([row], title="eight settings of two parameters")
    write_json(out / "settings.json", row)


def _stages(measure: Any, light_field: LightField, model: EdgeDepth) -> None:
    calibration, sides, measurement = model.calibration, model.sides, model.measurement
    assert isinstance(calibration, Calibrate)
    assert isinstance(sides, MapSides)
    assert measurement is not None
    points = measure("multi-view edges", multiview_edges, light_field, model).points
    gray = srgb_to_gray(light_field.center_view)
    lab = jnp.moveaxis(srgb_to_lab(light_field.center_view), -1, 0)
    guide = jnp.moveaxis(light_field.center_view, -1, 0)
    arms = crosshair(light_field)
    tried = jnp.linspace(*model.searched, calibration.hypotheses, dtype=gray.dtype)
    first = measure(
        "hypotheses",
        lean_jit(lambda a, b, c, p: hypotheses(a, b, c, p, window=calibration.window)),
        arms,
        lab,
        tried,
        calibration.matching,
    ).disparity
    shape = (gray.shape[0], gray.shape[1])
    measure(
        "surface vectors",
        lean_jit(lambda a, b, p: surface_vectors(a, None, b, p, shape=shape)),
        points,
        first,
        sides.vote,
    )
    params = AdaptedMeasurement(radius=measurement.radius, passes=measurement.passes)
    measured = measure(
        "dense labels",
        lean_jit(lambda s, a, b, p: labels(s.accumulate(b, p), a, b, p, passes=p.passes)),
        CrosshairSplines.of(arms),
        lab,
        first,
        params,
    )
    tx, ty = model.smoothness(lab, first, jnp.zeros_like(first))
    weight = 1e-4 / (1e-4 + measured.variance)
    system = System(weight, measured.disparity, 2 * tx, 2 * ty)
    found = measure("one diffusion", lambda s: diffuse(s), system)
    sharpen = model.refine.sharpen
    measure("sharpening", lean_jit(lambda part, d, g: part(d, g)), sharpen, found.value, guide)


if __name__ == "__main__":
    main()
