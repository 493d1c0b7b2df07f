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

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from _learning import Schedule, learned_by_seeds, means, of_one_range, plot_learning, scored
from _report import print_table, write_csv, write_json

from mvedge_jax import lean_jit
from mvedge_jax.depth import DepthResult, EdgeDepth
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.learn import Learned, RobustLoss
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
    if arguments.what == "taps":
        edges = model.edges
        assert isinstance(edges, OrientedEdges)
        model = model.replace({"edges.banks": edges.prewitt(one.views.shape)})
    what = ["edges.banks"] if arguments.what == "taps" else _every_number

    def estimate(model: EdgeDepth, field: LightField) -> jax.Array:
        return model(field.without_truth(), key=jax.random.key(0)).disparity

    loss = _held_out if arguments.loss == "views" else RobustLoss((arguments.scale,))
    chosen = [fields[name] for name in arguments.learn]
    runs = learned_by_seeds(model, what, chosen, arguments, loss=loss)
    cases = {"default": model, **{f"seed {k}": run.model for k, run in enumerate(runs)}}
    rows = scored(lean_jit(estimate), cases, fields, arguments.learn, arguments.what)
    print_table(rows, title=f"{arguments.steps} steps of Adam at {arguments.rate}")
    mean = means(rows, arguments.what)
    print_table(mean, title="means")
    changes = _changes(runs[0]) if arguments.what == "parameters" else []
    if changes:
        print_table(changes, title="the parameters that changed most, seed 0")
    losses = [run.losses.tolist() for run in runs]
    write_csv(arguments.out / "learn_parameters.csv", rows)
    write_json(
        arguments.out / "learn_parameters.json",
        {"losses": losses, "means": mean, "scores": rows, "parameters": changes},
    )
    figure = plot_learning(losses, rows, arguments.what, ("MSE*100", "BP(.07)"))
    figure.savefig(arguments.out / "learn_parameters.png")


def _every_number(path: str) -> bool:
    return "banks" not in path


def _held_out(result: DepthResult, field: LightField) -> jax.Array:
    """Reprojection error of the views that the crosshair's map was not made from."""
    vc, uc = field.center
    away = [(v, u) for v, u in np.ndindex(field.available.shape) if v != vc and u != uc]
    views = gather_views(field, choice=away)
    return self_supervised_loss(result.disparity, views, _ERROR_ALONE)[0]


def _changes(run: Learned, most: int = 12) -> list[dict[str, Any]]:
    """The parameters that moved most in their logarithm."""
    rows = [
        {
            "parameter": path,
            "default": float(run.values[path]) / factor,
            "learned": float(run.values[path]),
            "factor": factor,
        }
        for path, factor in run.factors().items()
    ]
    rows.sort(key=lambda row: -abs(np.log(row["factor"])))
    return rows[:most]


if __name__ == "__main__":
    main()
