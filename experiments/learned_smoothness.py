"""A learned smoothness (8.2): a part of one's own in preset `"edges"`, trained through the chain.

Labels are those of the multi-view edges; what is learned is where the diffusion between them stops.
A network of two 3x3 convolutions sees the image, the map before and its depth edges, and scales the
smoothness of the rule per edge; it starts as the rule. It is trained on some scenes, through the
solver (implicit gradients), and judged on others.

    python experiments/learned_smoothness.py --out results/learned_smoothness
"""

from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import tyro
from _learning import Schedule, learned_by_seeds, means, of_one_range, plot_learning, scored
from _report import print_table, write_json

from mvedge_jax import EdgeDepth, lean_jit
from mvedge_jax.learn import RobustLoss
from mvedge_jax.lightfield import LightField
from mvedge_jax.smoothness import ColorAndDepth


@dataclass(frozen=True)
class Arguments(Schedule):
    """Options.

    Attributes:
        learn: scenes to learn from.
        unseen: scenes to judge by.
        size: side of the views, px.
        views: views along a side of the grid; odd.
        out: folder for the table and the curve.
    """

    learn: tuple[str, ...] = ("edges", "demo", "thin", "wide")
    unseen: tuple[str, ...] = ("slanted", "crossing", "specular")
    size: int = 96
    views: int = 9
    steps: int = 80
    rate: float = 0.01
    out: Path = Path("results/learned_smoothness")


class Corrected(eqx.Module):
    """A `Smoothness`: that of the rule times a factor per edge, 1 at first."""

    first: eqx.nn.Conv2d
    last: eqx.nn.Conv2d

    def __init__(self, key: jax.Array):
        self.first = eqx.nn.Conv2d(5, 12, 3, padding=1, key=key)
        last = eqx.nn.Conv2d(12, 2, 3, padding=1, key=key)
        self.last = jax.tree.map(jnp.zeros_like, last)

    def __call__(
        self, guide: jax.Array, disparity: jax.Array, depth_edge: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """See `Smoothness`."""
        tx, ty = ColorAndDepth()(guide, disparity, depth_edge)
        seen = jnp.concatenate([guide / 50, disparity[None], depth_edge[None]])
        right, down = jnp.exp(self.last(jax.nn.tanh(self.first(seen))))
        return jnp.minimum(tx * right[:, :-1], 1), jnp.minimum(ty * down[:-1], 1)


def main() -> None:
    """Learns with every seed and judges."""
    arguments = tyro.cli(Arguments, description=__doc__)
    names = arguments.learn + arguments.unseen
    fields = of_one_range(names, size=arguments.size, views=arguments.views)
    chain = EdgeDepth.for_light_field(next(iter(fields.values())), preset="edges")

    def estimate(model: EdgeDepth, field: LightField) -> jax.Array:
        return model(field.without_truth()).disparity

    rule = chain.replace(smoothness=Corrected(jax.random.key(0)))
    seen = [fields[name] for name in arguments.learn]
    runs = learned_by_seeds(rule, ["smoothness"], seen, arguments, loss=RobustLoss((0.03,)))
    cases = {"the rule": rule, **{f"seed {k}": run.model for k, run in enumerate(runs)}}
    rows = scored(lean_jit(estimate), cases, fields, arguments.learn, "smoothness")
    print_table(rows, title="labels of the edges alone")
    mean = means(rows, "smoothness")
    print_table(mean, title="means")
    losses = [run.losses.tolist() for run in runs]
    write_json(
        arguments.out / "learned_smoothness.json",
        {"losses": losses, "means": mean, "scores": rows},
    )
    figure = plot_learning(losses, rows, "smoothness", ("MSE*100", "BP(.07)"))
    figure.savefig(arguments.out / "learned_smoothness.png")


if __name__ == "__main__":
    main()
