"""Figure C.1: noise on half of the points, and what the optimization recovers.

    python experiments/figure_c_1.py --data ../shared/data --scene hci/cotton
    python experiments/figure_c_1.py --scene hci/cotton --loss evidence

"Recovered" is (noisy - after) / (noisy - clean), of the MSE of the rendered maps. The views'
evidence is linearized around the map and reaches 0.1 px: what is farther off takes a few rounds.
It measures nothing beside depth steps, which first move to image edges for either kind of noise.
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from _model import (
    first_map,
    printer,
    run_self_supervised,
    run_supervised,
    scores,
)
from _report import print_table, shared_data, write_csv, write_json
from _scenes import find_scene
from peers.relocation import StepRelocation, relocate_steps

from mvedge_jax import lean_jit
from mvedge_jax.model import DepthModel, Renderer, Start, render_model
from mvedge_jax.model.approaches import ByEvidence, ByReprojection
from mvedge_jax.model.optimization import Rates


def noisy(
    model: DepthModel, *, position: float, disparity: float, key: jax.Array
) -> tuple[DepthModel, jax.Array]:
    """Adds Gaussian noise to a random half of the points; also says which."""
    which, move, change = jax.random.split(key, 3)
    n = model.valid.size
    half = jax.random.uniform(which, (n,)) < 0.5
    dtype = model.xy.dtype
    shift = position * jax.random.normal(move, (n, 2), dtype) * half[:, None]
    error = disparity * jax.random.normal(change, (n,), dtype) * half
    return eqx.tree_at(
        lambda m: (m.xy, m.disparity), model, (model.xy + shift, model.disparity + error)
    ), half


def far_off() -> ByReprojection:
    """Labels may go far, at rates to match; the result is kept whatever the views say of it."""
    rates = Rates(Rates.self_supervised().rate.at[1].set(0.01))
    label, margin = jnp.asarray(1.0), jnp.asarray(-jnp.inf)
    return ByReprojection(fit=None, label=label, margin=margin, rates=rates)


def main() -> None:
    """Runs the experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scene", default="hci/cotton")
    parser.add_argument("--iterations", type=int, default=60, help="of a round")
    parser.add_argument(
        "--loss", choices=["supervised", "evidence", "reprojection"], default="supervised"
    )
    parser.add_argument("--rounds", type=int, default=4, help="of the evidence")
    parser.add_argument("--raster", type=int, default=1)
    parser.add_argument("--position", type=float, nargs="+", default=[1.0])
    parser.add_argument("--disparity", type=float, nargs="+", default=[0.25])
    parser.add_argument("--out", type=Path, default=Path("results/figure_c_1"))
    arguments = parser.parse_args()
    light_field = find_scene(arguments.scene, arguments.data, size=128)
    start = first_map(light_field)
    renderer = Renderer.on_raster(arguments.raster)
    render = lean_jit(render_model)
    clean = scores(render(start.model, renderer).disparity, light_field)
    rows, curve = [], []
    cases = [(s, 0.0) for s in arguments.position] + [(0.0, s) for s in arguments.disparity]
    for position, disparity in cases:
        model, _ = noisy(start.model, position=position, disparity=disparity, key=jax.random.key(1))
        rendered = render(model, renderer).disparity
        before = scores(rendered, light_field)
        name = f"position {position}, disparity {disparity}"
        look = printer(name, light_field, curve)
        options = {"raster": arguments.raster, "iterations": arguments.iterations, "look": look}
        loose = Start(model, jnp.full_like(start.error, 0.1), rendered)
        if arguments.loss == "evidence":
            planes = jnp.moveaxis(light_field.center_view, -1, 0)
            near_edges = relocate_steps(loose.disparity, planes, StepRelocation())
            loose = loose._replace(disparity=near_edges)
            for _ in range(arguments.rounds):
                after = run_self_supervised(loose, light_field, approach=ByEvidence(), **options)
                loose = loose._replace(disparity=after)
            after = loose.disparity
        elif arguments.loss == "reprojection":
            after = run_self_supervised(loose, light_field, approach=far_off(), **options)
        else:
            after = run_supervised(loose, light_field, **options)
        found = scores(after, light_field)
        lost = before["mse"] - clean["mse"]
        rows.append(
            {
                "noise": name,
                "clean MSE": clean["mse"],
                "noisy MSE": before["mse"],
                "after MSE": found["mse"],
                "recovered %": 100 * (before["mse"] - found["mse"]) / lost if lost > 0 else None,
                "noisy BP(.07)": before["bad_07"],
                "after BP(.07)": found["bad_07"],
            }
        )
    print_table(rows, title="Figure C.1")
    write_csv(arguments.out / "noise.csv", rows)
    write_csv(arguments.out / "curve.csv", curve)
    write_json(arguments.out / "noise.json", rows)


if __name__ == "__main__":
    main()
