"""A learned smoothness (8.2) in a few lines: a small network corrects the rule of `edge_to_depth`.

Labels are those of the multi-view edges; what is learned is where the diffusion between them stops.
A network of two 3x3 convolutions sees image, labels and a first map, and scales the smoothness of
the rule per edge; it starts as the rule. It is trained through the solver (implicit gradients) on
some scenes and judged on others.

    python experiments/learned_smoothness.py --out results/learned_smoothness
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro
from _learning import means, plot_learning
from _report import print_table, write_json
from _scenes import scenes

from mvedge_jax import lean_jit
from mvedge_jax.depth import Parameters, Sizes, SmoothnessParams, edge_smoothness, edge_to_depth
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.diffusion import System, diffuse
from mvedge_jax.edges import rasterise
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores


@dataclass(frozen=True)
class Arguments:
    """Options: scenes to learn from and others to judge by, sizes, seeds."""

    learn: tuple[str, ...] = ("edges", "demo", "thin", "wide")
    unseen: tuple[str, ...] = ("slanted", "crossing", "specular")
    size: int = 96
    epochs: int = 40
    rate: float = 0.01
    seeds: int = 3
    out: Path = Path("results/learned_smoothness")


class Problem(NamedTuple):
    """What is diffused, and what should come out."""

    lab: jax.Array
    weight: jax.Array
    label: jax.Array
    truth: jax.Array


def problem(field: LightField) -> Problem:
    """Edge points of a light field as labels per pixel."""
    blind = field.without_truth()
    found = edge_to_depth(blind, Parameters(), Sizes.for_light_field(blind))
    points, shape = found.points, found.disparity.shape
    seen = rasterise(points.xy + found.surface.offset, points.disparity, points.valid, shape)
    assert field.truth is not None
    lab = jnp.moveaxis(srgb_to_lab(field.centre_view), -1, 0)
    label, weight = seen.values(points.disparity), seen.hit.astype(found.disparity.dtype)
    return Problem(lab, weight, label, field.truth.disparity)


class Network(eqx.Module):
    """The logarithm of a factor per edge, 0 at first."""

    first: eqx.nn.Conv2d
    last: eqx.nn.Conv2d

    def __init__(self, key: jax.Array):
        self.first = eqx.nn.Conv2d(6, 12, 3, padding=1, key=key)
        last = eqx.nn.Conv2d(12, 2, 3, padding=1, key=key)
        self.last = jax.tree.map(jnp.zeros_like, last)

    def __call__(self, lab: jax.Array, given: Problem, disparity: jax.Array) -> jax.Array:
        """Factors of the edges to the right and down."""
        rest = jnp.stack([given.weight, disparity, given.weight * (given.label - disparity)])
        return self.last(jax.nn.tanh(self.first(jnp.concatenate([lab / 50, rest]))))


def depth(network: Network, given: Problem, *, rounds: int = 3) -> jax.Array:
    """Diffused labels: the first time by colour alone, then with the steps of the map before."""
    disparity = jnp.zeros_like(given.label)
    for turn in range(rounds):
        powers = (1.5, 0.0) if turn == 0 else (1.5, 2.0)
        tx, ty = edge_smoothness(given.lab, disparity, SmoothnessParams(), powers=powers)
        if turn:
            right, down = jnp.exp(network(given.lab, given, disparity))
            tx, ty = tx * right[:, :-1], ty * down[:-1]
        disparity = diffuse(System(given.weight + 1e-6, given.label, tx, ty)).value
    return disparity


def learn(problems: list[Problem], arguments: Arguments, seed: int) -> tuple[Network, list[float]]:
    """One scene a step, in an order that the seed draws."""
    network = Network(jax.random.key(seed))
    adam = optax.adam(optax.cosine_decay_schedule(arguments.rate, arguments.epochs * len(problems)))
    state = adam.init(eqx.filter(network, eqx.is_array))

    def loss(network: Network, given: Problem) -> jax.Array:
        return jnp.mean(jnp.log1p(((depth(network, given) - given.truth) / 0.03) ** 2))

    @lean_jit
    def step(network: Network, state: Any, given: Problem) -> tuple[Network, Any, jax.Array]:
        value, gradient = eqx.filter_value_and_grad(loss)(network, given)
        updates, state = adam.update(gradient, state)
        return eqx.apply_updates(network, updates), state, value

    order, curve = np.random.default_rng(seed), []
    for _ in range(arguments.epochs):
        values = []
        for k in order.permutation(len(problems)):
            network, state, value = step(network, state, problems[k])
            values.append(float(value))
        curve.append(sum(values) / len(values))
    return network, curve


def main() -> None:
    """Learns with every seed and judges."""
    arguments = tyro.cli(Arguments, description=__doc__)
    names = arguments.learn + arguments.unseen
    given = {k: problem(f) for k, f in scenes(None, names, size=arguments.size)}
    runs = [
        learn([given[k] for k in arguments.learn], arguments, s) for s in range(arguments.seeds)
    ]
    networks = {"the rule": Network(jax.random.key(0))}
    networks |= {f"seed {seed}": network for seed, (network, _) in enumerate(runs)}
    judged, rows = lean_jit(depth), []
    for name in names:
        use = "learned from" if name in arguments.learn else "unseen"
        for label, network in networks.items():
            scores = depth_scores(judged(network, given[name]), given[name].truth)
            found = {"MSE*100": float(scores.mse), "BP(.07)": float(scores.bad_07)}
            rows.append({"scene": name, "use": use, "smoothness": label, **found})
    print_table(rows, title="labels of the edges alone")
    mean = means(rows, "smoothness")
    print_table(mean, title="means")
    losses = [curve for _, curve in runs]
    write_json(
        arguments.out / "learned_smoothness.json",
        {"losses": losses, "means": mean, "scores": rows},
    )
    over = ("epoch", "loss")
    figure = plot_learning(losses, rows, "smoothness", ("MSE*100", "BP(.07)"), over=over)
    figure.savefig(arguments.out / "learned_smoothness.png")


if __name__ == "__main__":
    main()
