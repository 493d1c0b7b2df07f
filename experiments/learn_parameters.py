"""Parameters, or filters, learned by gradient: Adam through the whole chain.

Small synthetic scenes are learned from, in mini-batches that each seed draws, and others are only
measured before and after. The loss is the mean of `log(1 + (error / scale)²)`, or, without any
truth, the reprojection error of the views that the chain does not read, those off the crosshair.
Parameters are moved by their logarithm, so that a step is a percentage; leaves that are thresholds
have no derivative and stay. Taps of the filter bank are moved as they are.

    python experiments/learn_parameters.py --out results/learn_parameters
    python experiments/learn_parameters.py --loss views --out results/learn_views
    python experiments/learn_parameters.py --what taps --preset edges --rate 0.003 --steps 20
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from _depth import robust_loss
from _learning import Schedule, learned_by_seeds, means, of_one_range, plot_learning, scored
from _report import print_table, write_csv, write_json

from mvedge_jax import lean_jit
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.epi import FilterBank
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses import LossWeights, gather_views, self_supervised_loss

_ERROR_ALONE = LossWeights(smoothness=jnp.asarray(0.0), gradient=jnp.asarray(0.0))


@dataclass(frozen=True)
class Arguments(Schedule):
    """Options.

    Attributes:
        what: the numbers of the model, or the taps of the filter bank.
        preset: of the chain.
        loss: by the truth, or by the views off the crosshair.
        scale: errors well above it count little more than those near it, px; of the truth's loss.
        learn: scenes to learn from.
        unseen: scenes to measure besides.
        size: side of the views, px.
        views: views along a side of the grid; odd.
        out: folder for the table, the curve and the parameters.
    """

    what: Literal["parameters", "taps"] = "parameters"
    preset: Literal["full", "edges"] = "full"
    loss: Literal["truth", "views"] = "truth"
    scale: float = 0.07
    steps: int = 80
    rate: float = 0.1
    learn: tuple[str, ...] = ("edges", "demo", "thin", "wide")
    unseen: tuple[str, ...] = ("slanted", "crossing", "specular")
    size: int = 96
    views: int = 9
    out: Path = Path("results/learn_parameters")


def main() -> None:
    """Learns, measures and draws."""
    arguments = tyro.cli(Arguments, description=__doc__)
    fields = of_one_range(
        arguments.learn + arguments.unseen, size=arguments.size, views=arguments.views
    )
    one = next(iter(fields.values()))
    model = EdgeDepth.for_light_field(one, preset=arguments.preset)
    first, model_of = _choice(arguments.what, one, model)

    def estimate(learned: Any, field: LightField) -> jax.Array:
        return model_of(learned)(field.without_truth(), key=jax.random.key(0)).disparity

    def loss(learned: Any, field: LightField) -> jax.Array:
        found = estimate(learned, field)
        if arguments.loss == "views":
            return _held_out(found, field)
        return robust_loss(found, field, arguments.scale)

    value_and_gradient = lean_jit(jax.value_and_grad(loss))
    chosen = [fields[name] for name in arguments.learn]
    runs = learned_by_seeds(value_and_gradient, first, chosen, arguments)
    cases = {"default": first, **{f"seed {k}": point for k, (point, _) in enumerate(runs)}}
    rows = scored(lean_jit(estimate), cases, fields, arguments.learn, arguments.what)
    print_table(rows, title=f"{arguments.steps} steps of Adam at {arguments.rate}")
    mean = means(rows, arguments.what)
    print_table(mean, title="means")
    best = runs[0][0]
    changes = _changes(first, best) if arguments.what == "parameters" else []
    if changes:
        print_table(changes, title="the parameters that changed most, seed 0")
    losses = [curve for _, curve in runs]
    write_csv(arguments.out / "learn_parameters.csv", rows)
    write_json(
        arguments.out / "learn_parameters.json",
        {"losses": losses, "means": mean, "scores": rows, "parameters": changes},
    )
    figure = plot_learning(losses, rows, arguments.what, ("MSE*100", "BP(.07)"))
    figure.savefig(arguments.out / "learn_parameters.png")


def _held_out(disparity: jax.Array, field: LightField) -> jax.Array:
    """Reprojection error of the views that the crosshair's map was not made from."""
    vc, uc = field.centre
    away = [(v, u) for v, u in np.ndindex(field.available.shape) if v != vc and u != uc]
    return self_supervised_loss(disparity, gather_views(field, choice=away), _ERROR_ALONE)[0]


def _choice(
    what: str, field: LightField, model: EdgeDepth
) -> tuple[Any, Callable[[Any], EdgeDepth]]:
    """What is learned, at its start, and the model that it makes."""
    if what == "parameters":
        return jax.tree.map(jnp.log, model), lambda logs: jax.tree.map(jnp.exp, logs)
    edges = model.edges
    assert isinstance(edges, OrientedEdges)
    banks = edges.prewitt(field.views.shape)

    def with_taps(taps: Any) -> EdgeDepth:
        across, down = (FilterBank(bank.disparity, t) for bank, t in zip(banks, taps, strict=True))
        return model.replace({"edges.banks": (across, down)})

    return [bank.taps for bank in banks], with_taps


def _changes(first: Any, best: Any, most: int = 12) -> list[dict[str, Any]]:
    """The parameters that moved most in their logarithm."""
    pairs = zip(jax.tree_util.tree_leaves_with_path(first), jax.tree.leaves(best), strict=True)
    rows = [
        {
            "parameter": jax.tree_util.keystr(path).lstrip("."),
            "default": float(jnp.exp(default)),
            "learned": float(jnp.exp(log)),
            "factor": float(jnp.exp(log - default)),
        }
        for (path, default), log in pairs
    ]
    rows.sort(key=lambda row: -abs(jnp.log(row["factor"])))
    return rows[:most]


if __name__ == "__main__":
    main()
