"""Points that a nearer neighbor hides: what brings them back into the optimization.

    python experiments/hidden_points.py

A square stands in front of a plane. Some of the points on it and beside it are given a label that
is too near, so that they hide the right ones around them, which get next to no gradient. The
supervised optimization is run with all points opaque as in the thesis, with opacities that fall
with the weight (`Renderer.clears`), with hidden points recycled (`grow`), with both, and with
points that are too narrow to hide their neighbors (`SplatLabels.on_raster`).
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from _report import print_table, write_csv, write_json

from mvedge_jax import lean_jit
from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.model import (
    DepthModel,
    Renderer,
    Start,
    SupervisedFit,
    fit_edges,
    render_model,
)
from mvedge_jax.model.optimization import FixedPoints, Growth, Rates, all_at_once
from mvedge_jax.model.optimization._grow import usefulness
from mvedge_jax.splatting import SplatLabels, SplatRaster, SplatWidths

SHAPE = (32, 40)
PIECES = 4


def noisy_points(truth: jax.Array, count: int, share: float, seed: int) -> DepthModel:
    """Random points with the true labels, a share of them 0.3 to 1 px too near."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (count, 2))
    column, row = np.round(xy).astype(int).T
    label = np.asarray(truth)[row, column]
    label = label + (rng.random(count) < share) * rng.uniform(0.3, 1.0, count)
    zero = jnp.zeros(count, jnp.float32)
    return DepthModel(
        jnp.asarray(label, jnp.float32),
        jnp.asarray(xy, jnp.float32),
        zero,
        jnp.zeros(SHAPE, jnp.float32),
        jnp.ones(count, bool),
    )


def main() -> None:
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=260)
    parser.add_argument("--share", type=float, default=0.3, help="of points that are too near")
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("results/hidden_points"))
    arguments = parser.parse_args()
    truth = jnp.zeros(SHAPE, jnp.float32).at[8:24, 12:28].set(1.0)
    known = GroundTruth(truth, jnp.ones(SHAPE, bool))
    wide, narrow = SplatWidths(), SplatLabels.on_raster(1).widths
    rates = Rates(rate=jnp.asarray([0.15, 0.01, 0.08, 0.05]))
    table = all_at_once(rates, iterations=arguments.iterations)
    # In the pauses between four pieces a tenth of the points may move.
    until = jnp.asarray(1 - 1 / PIECES)
    recycling = Growth(rounds=PIECES - 1, until=until, count=arguments.points // 10)
    render = lean_jit(render_model)
    rows = []
    for name, clears, recycles, widths in (
        ("nothing (thesis)", False, False, wide),
        ("opacity", True, False, wide),
        ("recycling", False, True, wide),
        ("both", True, True, wide),
        ("narrow points", False, False, narrow),
        ("narrow points and both", True, True, narrow),
    ):
        splat = SplatLabels(widths, SplatRaster(scale=1, lanes=16))
        renderer = Renderer(splat, clears=clears)
        errors, hidden = np.zeros((arguments.seeds, 2)), np.zeros((arguments.seeds, 2))
        for seed in range(arguments.seeds):
            model = noisy_points(truth, arguments.points, arguments.share, seed)
            start = Start(model, jnp.ones_like(model.disparity), truth * 0)
            strategy = recycling if recycles else FixedPoints()
            best = fit_edges(
                known, start, SupervisedFit(), renderer, strategy=strategy, routine=table
            ).model
            for column, theta in enumerate((model, best)):
                found = render(theta, renderer).disparity
                errors[seed, column] = 100 * float(jnp.mean((found - truth) ** 2))
                use = usefulness(theta, renderer)
                hidden[seed, column] = 100 * float(jnp.mean(use < 0.05))
        rows.append(
            {
                "way back": name,
                "MSE*100 before": errors[:, 0].mean(),
                "MSE*100 after": errors[:, 1].mean(),
                "worst seed": errors[:, 1].max(),
                "hidden % before": hidden[:, 0].mean(),
                "hidden % after": hidden[:, 1].mean(),
            }
        )
        print(rows[-1], flush=True)
    print_table(rows, title="points that a nearer neighbor hides")
    write_csv(arguments.out / "hidden_points.csv", rows)
    write_json(arguments.out / "hidden_points.json", rows)


if __name__ == "__main__":
    main()
