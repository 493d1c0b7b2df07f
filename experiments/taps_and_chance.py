"""Do taps learned by gradient do better than chance? Adam on the filters of preset `edges`.

From one scene at a time, Adam moves every tap for itself; the loss is the mean of
`log(1 + (error / scale)²)`. The losses of all scenes at the end are put beside those of random taps
that are as far from the Prewitt filters: the loss is rugged, and what random taps change is chance.
With `--answered`, a point's weight is multiplied by its confidence, so that the response of the
filters acts on labels' weights, and not on their places alone.

    python experiments/taps_and_chance.py --out results/taps_and_chance
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import optax
import tyro
from _learning import of_one_range
from _report import print_table, write_json
from jax import Array
from jaxtyping import Float

from mvedge_jax import lean_jit
from mvedge_jax.depth import EdgeDepth, PointWeight
from mvedge_jax.edges import EdgePoints, OrientedEdges
from mvedge_jax.epi import FilterBank
from mvedge_jax.learn import robust_loss
from mvedge_jax.lightfield import LightField


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scenes: each is learned from, and unseen where another one is.
        size: side of the views, px.
        steps: of Adam.
        rates: learning rates at first, in root mean squares of the taps; they fall to 0 along a
            cosine.
        scale: errors well above it count little more than those near it, px.
        random: random taps beside each run.
        answered: whether confidences multiply the weights of points.
        out: folder for the table.
    """

    scenes: tuple[str, ...] = ("edges", "crossing", "demo")
    size: int = 64
    steps: int = 20
    rates: tuple[float, ...] = (0.03, 0.01)
    scale: float = 0.07
    random: int = 3
    answered: bool = False
    out: Path = Path("results/taps_and_chance")


class Answered(PointWeight):
    """Weights of points, multiplied by how strongly the filters answer."""

    def __call__(
        self, confidence: Float[Array, " n"], points: EdgePoints, precision: Float[Array, ""]
    ) -> Float[Array, " n"]:
        """See `PointWeight`."""
        return super().__call__(confidence, points, precision) * points.confidence


def main() -> None:
    """Learns from each scene at each rate, and prints losses relative to the Prewitt filters'."""
    arguments = tyro.cli(Arguments, description=__doc__)
    fields = of_one_range(arguments.scenes, size=arguments.size)
    one = next(iter(fields.values()))
    model = EdgeDepth.for_light_field(one, preset="edges", choices={"refine.sharpen.levels": 24})
    if arguments.answered:
        model = model.replace({"labels.weight": Answered()})
    assert isinstance(model.edges, OrientedEdges)
    banks = model.edges.prewitt(one.views.shape)

    def loss(moved: Sequence[Array], field: LightField) -> Array:
        across, down = (
            FilterBank(bank.disparity, bank.taps + jnp.sqrt(jnp.mean(bank.taps**2)) * share)
            for bank, share in zip(banks, moved, strict=True)
        )
        found = model.replace({"edges.banks": (across, down)})(field.without_truth())
        return robust_loss(found.disparity, field, scales=(arguments.scale,))

    value_and_gradient = lean_jit(jax.value_and_grad(loss))
    first = [jnp.zeros_like(bank.taps) for bank in banks]
    start = {name: float(value_and_gradient(first, field)[0]) for name, field in fields.items()}

    def shares(moved: Sequence[Array]) -> dict[str, float]:
        ends = {name: float(value_and_gradient(moved, field)[0]) for name, field in fields.items()}
        return {name: round(end / start[name], 3) for name, end in ends.items()}

    rows = []
    for name, field in fields.items():
        for rate in arguments.rates:
            moved, losses = _learned(value_and_gradient, first, field, rate, arguments.steps)
            far = float(jnp.sqrt(jnp.mean(jnp.concatenate([jnp.ravel(a) for a in moved]) ** 2)))
            run = {"from": name, "rate": rate, "rms": far}
            rows.append({**run, "taps": "learned", **shares(moved)})
            for seed in range(arguments.random):
                rows.append({**run, "taps": "random", **shares(_random(first, far, seed))})
            best = min(losses) / start[name]
            print_table(rows, title=f"losses, 1 before; best on the way from {name} {best:.3f}")
            write_json(arguments.out / "taps_and_chance.json", {"before": start, "rows": rows})


def _learned(
    value_and_gradient: Any, first: Any, field: LightField, rate: float, steps: int
) -> tuple[Any, list[float]]:
    """Where Adam ends, and its losses."""
    adam = optax.adam(optax.cosine_decay_schedule(rate, steps))
    moved, state, losses = first, adam.init(first), []
    for _ in range(steps):
        value, slope = value_and_gradient(moved, field)
        losses.append(float(value))
        updates, state = adam.update(slope, state, moved)
        moved = optax.apply_updates(moved, updates)
    return moved, losses


def _random(like: Sequence[Array], far: float, seed: int) -> list[Array]:
    keys = jax.random.split(jax.random.key(seed), len(like))
    pairs = zip(keys, like, strict=True)
    return [far * jax.random.normal(key, leaf.shape, leaf.dtype) for key, leaf in pairs]


if __name__ == "__main__":
    main()
