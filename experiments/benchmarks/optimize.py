"""Time and memory of one optimization step, in parts, from 700 to 50,000 points.

    python experiments/benchmarks/optimize.py --points 700 5000 20000 50000

Points lie on random curves over a 512x512 image with a raster of twice that; the authors' PyTorch
code took 2.1, 5.1, 18 and 36 s for splat, solve and backward at these counts on such a machine.
"""

import argparse
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import peak_memory, print_table, timed, write_json

from mvedge_jax import lean_jit
from mvedge_jax.losses import Views
from mvedge_jax.model import DepthModel, Renderer, render_model
from mvedge_jax.model._model import opacities, splat_model
from mvedge_jax.model.objectives import SelfSupervised, unlimited
from mvedge_jax.model.optimization import Rates, advance, all_at_once, begin
from mvedge_jax.splatting import SplatLabels

AUTHORS = {700: 2.1, 5000: 5.1, 20000: 18.0, 50000: 36.0}


def curves(count: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """Points along smooth random curves, as edges lie in an image."""
    per = 200
    starts = rng.uniform(0, size, (count // per + 1, 1, 2))
    turn = rng.normal(size=(len(starts), 1)) * 1.5
    angle = rng.uniform(0, 2 * np.pi, (len(starts), 1)) + turn * np.linspace(0, 1, per)[None]
    length = rng.uniform(50, 250, (len(starts), 1, 1)) / per
    steps = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * length
    points = (starts + np.cumsum(steps, axis=1)).reshape(-1, 2)[:count]
    return np.clip(points, 0, size - 1)


def scene(count: int, size: int) -> tuple[DepthModel, Views]:
    """A model with `count` points and eight random views."""
    rng = np.random.default_rng(0)
    texture = rng.random((9, 3, size, size)).astype(np.float32)
    steps = np.array([[4, 0], [-4, 0], [0, 4], [0, -4], [2, 0], [-2, 0], [0, 2], [0, -2]])
    model = DepthModel(
        jnp.asarray(rng.normal(size=count).astype(np.float32) * 0.5),
        jnp.asarray(curves(count, size, rng).astype(np.float32)),
        jnp.zeros(count, jnp.float32),
        jnp.asarray(rng.random((size, size)).astype(np.float32) ** 4 * 4),
        jnp.ones(count, bool),
    )
    views = Views(
        jnp.asarray(texture[0]),
        jnp.asarray(texture[1:]),
        jnp.asarray(steps, jnp.float32),
        jnp.ones(8, bool),
    )
    return model, views


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, nargs="+", default=[700, 5000, 20000, 50000])
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--check", action="store_true", help="fail if a budget is missed")
    parser.add_argument("--out", type=Path, default=Path("results/benchmark_optimize"))
    arguments = parser.parse_args()
    renderer = Renderer(SplatLabels.thesis())
    rows = []
    for count in arguments.points:
        model, views = scene(count, arguments.size)
        start = jnp.zeros((arguments.size, arguments.size), jnp.float32)
        moving, fixed = eqx.partition(model, eqx.is_inexact_array)
        cotangent = jnp.full_like(start, 1e-6)

        @lean_jit
        def splat_only(moving, fixed=fixed):
            model = eqx.combine(moving, fixed)
            opacity = opacities(model, renderer)
            return splat_model(model, jnp.exp(-model.log_weight), opacity, renderer).label

        @lean_jit
        def forward(moving, fixed=fixed, start=start):
            return render_model(eqx.combine(moving, fixed), renderer, start=start).disparity

        @lean_jit
        def backward(moving, forward=forward, cotangent=cotangent):
            value, pull = jax.vjp(forward, moving)
            return value, pull(cotangent)

        goal = SelfSupervised(views, unlimited(model), renderer)
        state = begin(model, start, key=jax.random.key(0))
        table = all_at_once(Rates(), iterations=1)
        runs = {
            "splat": (splat_only, (moving,)),
            "splat + solve": (forward, (moving,)),
            "splat + solve + backward": (backward, (moving,)),
            "whole step, 8 views": (lambda s: advance(s, table, goal), (state,)),  # noqa: B023
        }
        for name, (function, inputs) in runs.items():
            _, timing = timed(function, *inputs, repeats=arguments.repeats)
            peer = AUTHORS.get(count) if name == "splat + solve + backward" else None
            rows.append(
                {
                    "points": count,
                    "part": name,
                    "median s": timing.median,
                    "best s": timing.best,
                    "compile s": timing.first - timing.best,
                    "authors s": peer,
                    "times faster": peer / timing.median if peer else None,
                }
            )
        print_table(rows[-4:], title=f"{count} points")
    print_table(rows, title="one step")
    gib = peak_memory() / 2**30
    print(f"peak memory {gib:.2f} GiB")
    write_json(arguments.out / "optimize.json", {"rows": rows, "peak GiB": gib})
    if arguments.check:
        worst = {r["part"]: r["median s"] for r in rows if r["points"] == max(arguments.points)}
        budgets = {"splat + solve + backward": 1.0, "whole step, 8 views": 1.5}
        missed = {k: worst[k] for k, limit in budgets.items() if worst[k] > limit}
        if missed or gib > 3:
            raise SystemExit(f"over budget: {missed}, {gib:.2f} GiB")


if __name__ == "__main__":
    main()
