"""Parameters, or filters, learned by gradient: Adam through the whole chain.

Small synthetic scenes are learned from and others are only measured before and after. The loss is
the mean of `log(1 + (error / 0.03 px)²)` over the learned scenes. Parameters are moved by their
logarithm, so that a step is a percentage; leaves that are thresholds have no derivative and stay.
Taps of the filter bank are moved as they are.

    python experiments/learn_parameters.py --out results/learn_parameters
    python experiments/learn_parameters.py --what taps --learn demo --rate 0.003 --out results/taps
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
import tyro
from _depth import robust_loss, scenes
from _report import print_table, write_csv, write_json
from matplotlib.figure import Figure

from mvedge_jax.centre import Parameters, Sizes, edge_to_depth
from mvedge_jax.edges import EdgeParams, scene_range
from mvedge_jax.epi import FilterBank
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        what: the numbers of `Parameters`, or the taps of the filter bank.
        learn: scenes to learn from.
        unseen: scenes to measure besides.
        size: side of the views, px.
        steps: of Adam.
        rate: its learning rate, in the logarithm of the parameters or in units of the taps.
        out: folder for the table, the curve and the parameters.
    """

    what: Literal["parameters", "taps"] = "parameters"
    learn: tuple[str, ...] = ("edges", "demo")
    unseen: tuple[str, ...] = ("slanted", "specular")
    size: int = 96
    steps: int = 20
    rate: float = 0.05
    out: Path = Path("results/learn_parameters")


def main() -> None:
    """Learns, measures and draws."""
    arguments = tyro.cli(Arguments, description=__doc__)
    fields = dict(scenes(None, arguments.learn + arguments.unseen, size=arguments.size))
    # The widest range for all, so that one program serves them.
    lows, highs = zip(*(scene_range(field) for field in fields.values()), strict=True)
    widest = (min(lows), max(highs))
    fields = {
        name: LightField(field.views, disparity_range=widest, truth=field.truth)
        for name, field in fields.items()
    }
    sizes = Sizes.for_light_field(next(iter(fields.values())))

    first, parameters = _choice(arguments.what, next(iter(fields.values())), sizes)

    def loss(learned: Any, field: LightField) -> tuple[jax.Array, jax.Array]:
        found = edge_to_depth(field.without_truth(), parameters(learned), sizes).disparity
        return robust_loss(found, field), found

    value_and_gradient = eqx.filter_jit(jax.value_and_grad(loss, has_aux=True))
    learned = best = first
    adam = optax.adam(arguments.rate)
    state = adam.init(learned)
    losses, lowest = [], float("inf")
    for step in range(arguments.steps + 1):
        start = time.perf_counter()
        found = [value_and_gradient(learned, fields[name]) for name in arguments.learn]
        value = sum(float(v) for (v, _), _ in found) / len(found)
        losses.append(value)
        if value < lowest:
            best, lowest = learned, value
        print(f"step {step}: loss {value:.5f}, {time.perf_counter() - start:.1f} s", flush=True)
        gradient = jax.tree.map(lambda *leaves: sum(leaves) / len(leaves), *(g for _, g in found))
        updates, state = adam.update(gradient, state, learned)
        learned = optax.apply_updates(learned, updates)

    estimate = eqx.filter_jit(lambda learned, field: loss(learned, field)[1])
    rows = []
    for name, field in fields.items():
        assert field.truth is not None
        for label, point in (("default", first), ("learned", best)):
            scores = depth_scores(
                estimate(point, field), field.truth.disparity, mask=field.truth.valid
            )
            rows.append(
                {
                    "scene": name,
                    "use": "learned from" if name in arguments.learn else "unseen",
                    arguments.what: label,
                    "MSE*100": float(scores.mse),
                    "Q25*100": float(scores.q25),
                    "BP(.01)": float(scores.bad_01),
                    "BP(.03)": float(scores.bad_03),
                    "BP(.07)": float(scores.bad_07),
                }
            )
    print_table(rows, title=f"{arguments.steps} steps of Adam at {arguments.rate}")
    changes = _changes(first, best) if arguments.what == "parameters" else []
    if changes:
        print_table(changes, title="the parameters that changed most")
    write_csv(arguments.out / "learn_parameters.csv", rows)
    write_json(
        arguments.out / "learn_parameters.json",
        {"losses": losses, "scores": rows, "parameters": changes},
    )
    _plot(losses, rows, arguments.what).savefig(arguments.out / "learn_parameters.png")


def _choice(what: str, field: LightField, sizes: Sizes) -> tuple[Any, Callable[[Any], Parameters]]:
    """What is learned, at its start, and the parameters that it makes."""
    if what == "parameters":
        return jax.tree.map(jnp.log, Parameters()), lambda logs: jax.tree.map(jnp.exp, logs)
    banks = sizes.edges.banks(field.views.shape)

    def with_taps(taps: Any) -> Parameters:
        across, down = (FilterBank(bank.disparity, t) for bank, t in zip(banks, taps, strict=True))
        return Parameters(edges=EdgeParams(banks=(across, down)))

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


def _plot(losses: list[float], rows: list[dict[str, Any]], what: str) -> Figure:
    """The loss curve, and the scores before and after per scene."""
    figure = Figure(figsize=(13, 3.6), layout="constrained")
    curve, *axes = figure.subplots(1, 3)
    curve.plot(losses, "o-", markersize=3)
    curve.set(xlabel="step of Adam", ylabel="loss of the scenes learned from")
    names = list(dict.fromkeys(row["scene"] for row in rows))
    titles = {row["scene"]: f"{row['scene']}\n({row['use']})" for row in rows}
    for axis, column in zip(axes, ("MSE*100", "BP(.07)"), strict=True):
        for shift, label in ((-0.2, "default"), (0.2, "learned")):
            heights = [row[column] for row in rows if row[what] == label]
            axis.bar([k + shift for k in range(len(names))], heights, 0.38, label=label)
        axis.set_xticks(range(len(names)), [titles[name] for name in names], fontsize=7)
        axis.set(ylabel=column)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


if __name__ == "__main__":
    main()
