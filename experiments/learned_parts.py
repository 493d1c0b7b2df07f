"""A learned smoothness and learned label weights, trained through the solver on random scenes.

Preset `"edges"`: labels are those of the multi-view edges. One network scales the odds of the rule
that cuts edges between pixels, another one the weights of the labels; both start as the rule.
Random scenes are learned from and validated on; others, and the named ones, are judged by.

    python experiments/learned_parts.py --out results/learned_parts
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import tyro
from _learning import means, scored
from _report import peak_memory, print_table, write_csv, write_json

from mvedge_jax import EdgeDepth, lean_jit
from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic import random_scenes
from mvedge_jax.depth import PointLabels
from mvedge_jax.depth.solves import Labels
from mvedge_jax.learn import Learned, Progress, learn, of_one_range, plot_learning
from mvedge_jax.lightfield import LightField
from mvedge_jax.smoothness import ColorAndDepth


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        what: both networks, that of the smoothness alone, or the numbers of the rule, of labels and
            of refinement in place of networks.
        scenes: random scenes to learn from.
        held: random scenes for validation, and as many to judge by.
        size: side of the views, px.
        views: views along a side of the grid; odd.
        steps: of Adam.
        batch: scenes per step.
        seeds: runs, each with its own scenes' order and weights.
        rate: the learning rate at first.
        check_every: steps between validations.
        out: folder for tables, curves, weights and checkpoints.
    """

    what: Literal["both", "smoothness", "numbers"] = "both"
    scenes: int = 100
    held: int = 16
    size: int = 64
    views: int = 5
    steps: int = 400
    batch: int = 2
    seeds: int = 1
    rate: float = 0.003
    check_every: int = 40
    out: Path = Path("results/learned_parts")


def convolutions(inputs: int, width: int, dilations: tuple[int, ...], outputs: int, key: Any):
    """3x3 convolutions with ReLU between them; the last one is 0 at first."""
    keys, sizes = jax.random.split(key, len(dilations)), [inputs, *[width] * (len(dilations) - 1)]
    layers = []
    for k, (dilation, own) in enumerate(zip(dilations, keys, strict=True)):
        after = outputs if k == len(dilations) - 1 else width
        layer = eqx.nn.Conv2d(sizes[k], after, 3, padding=dilation, dilation=dilation, key=own)
        layers.append(layer)
    layers[-1] = jax.tree.map(jnp.zeros_like, layers[-1])
    return layers


def passed(layers: list[eqx.nn.Conv2d], seen: jax.Array) -> jax.Array:
    """What a stack of convolutions says."""
    for layer in layers[:-1]:
        seen = jax.nn.relu(layer(seen))
    return layers[-1](seen)


def steps_of(image: jax.Array, scale: jax.Array | float) -> jax.Array:
    """Logarithms of the steps to the right and downwards, `[2, y, x]`."""

    def log(axis: int) -> jax.Array:
        square = jnp.sum((jnp.diff(image, axis=axis) / scale) ** 2, axis=0)
        widths = [(0, int(k == axis - 1)) for k in range(2)]
        return 0.25 * jnp.log(jnp.pad(square, widths) + 1e-3)

    return jnp.stack([log(2), log(1)])


class LearnedSmoothness(eqx.Module):
    """A `Smoothness`: the rule with its odds scaled per edge."""

    rule: ColorAndDepth
    network: list[eqx.nn.Conv2d]

    def __call__(
        self, guide: jax.Array, disparity: jax.Array, depth_edge: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """See `Smoothness`."""
        rule = self.rule
        tx, ty = rule(guide, disparity, depth_edge)
        depth = steps_of(disparity[None], rule.depth)
        edge = 0.25 * jnp.log((depth_edge[None] / rule.depth) ** 2 + 1e-3)
        seen = jnp.concatenate([guide / 50, steps_of(guide, rule.color), depth, edge])
        right, down = 4 * jnp.tanh(0.25 * passed(self.network, seen))

        def scaled(t: jax.Array, odds: jax.Array) -> jax.Array:
            return jnp.maximum(1 / (1 + (1 / t - 1) * jnp.exp(-odds)), rule.floor)

        return scaled(tx, right[:, :-1]), scaled(ty, down[:-1])


class LearnedLabels(eqx.Module):
    """`PointLabels` whose weights a network scales."""

    labels: PointLabels
    network: list[eqx.nn.Conv2d]

    def __call__(self, points: Any, sides: Any, evidence: Any, precision: jax.Array) -> Labels:
        """See `PointLabels`."""
        found = self.labels(points, sides, evidence, precision)
        guide = evidence.calibrated.guide
        known = jnp.log(found.weight + 1e-3)[None]
        seen = jnp.concatenate([guide / 50, steps_of(guide, 1.0), 0.3 * known, found.weight[None]])
        (factor,) = 3 * jnp.tanh(passed(self.network, seen) / 3)
        return Labels(found.weight * jnp.exp(factor), found.value)


def with_networks(model: EdgeDepth, key: jax.Array) -> EdgeDepth:
    """The model whose smoothness and labels have networks, which change nothing yet."""
    keys = jax.random.split(key)
    rule = model.smoothness
    assert isinstance(rule, ColorAndDepth)
    cut = LearnedSmoothness(rule, convolutions(8, 24, (1, 2, 4, 1), 2, keys[0]))
    weighed = LearnedLabels(model.labels, convolutions(7, 16, (1, 2, 1), 1, keys[1]))
    return model.replace(smoothness=cut, labels=weighed)


_WHAT = {
    "both": ["smoothness.network", "labels.network"],
    "smoothness": ["smoothness.network"],
    "numbers": ["smoothness.rule", "labels.labels", "refine"],
}


def trained(arguments: Arguments, seed: int) -> Learned:
    """A run."""
    shape = (arguments.views, arguments.views, arguments.size, arguments.size)
    key = jax.random.key(0)
    scenes = random_scenes.random_light_fields(shape=shape, count=arguments.scenes, key=key)
    held = random_scenes.random_light_fields(
        shape=shape, split="validation", count=arguments.held, key=key
    )
    plain = EdgeDepth.for_light_field(scenes[0].without_truth(), preset="edges")
    model = with_networks(plain, jax.random.key(seed))

    def tell(now: Progress) -> None:
        text = f"seed {seed}, step {now.step}: loss {now.loss:.4f}"
        print(f"{text}, validation {now.validation:.4f}", flush=True)

    return learn(
        model,
        _WHAT[arguments.what],
        scenes,
        validation=held,
        optimizer=optax.adam(optax.cosine_decay_schedule(arguments.rate, arguments.steps)),
        steps=arguments.steps,
        batch=arguments.batch,
        limit=3.0,
        check_every=arguments.check_every,
        checkpoint=arguments.out / f"seed {seed}",
        progress=tell,
        key=jax.random.key(seed),
    )


def judged(arguments: Arguments, found: list[Learned]) -> list[dict[str, Any]]:
    """Rows of scores on scenes that were never used."""
    shape = (arguments.views, arguments.views, arguments.size, arguments.size)
    fields = random_scenes.random_light_fields(
        shape=shape, split="test", count=arguments.held, key=jax.random.key(0)
    )
    named = [
        synthetic.render(synthetic.scene(name), shape=shape, key=jax.random.key(0))
        for name in synthetic.scene_names()
    ]
    rows = []
    for kind, group in (("random, unseen", list(fields)), ("named, unseen", of_one_range(named))):
        plain = EdgeDepth.for_light_field(group[0].without_truth(), preset="edges")
        start = with_networks(plain, jax.random.key(0))

        @lean_jit
        def program(model: EdgeDepth, bare: LightField) -> jax.Array:
            return model(bare).disparity

        def estimate(model: EdgeDepth, field: LightField, program: Any = program) -> jax.Array:
            return program(model, field.bare())

        cases = {"the rule": start}
        for seed, run in enumerate(found):
            cases[f"seed {seed}"] = start.replace(dict(run.values))
        by_name = {field.name: field for field in group}
        own = scored(estimate, cases, by_name, (), arguments.what)
        rows += [{**row, "use": kind} for row in own]
    return rows


def main() -> None:
    """Learns with every seed and judges."""
    arguments = tyro.cli(Arguments, description=__doc__)
    start, found = time.perf_counter(), []
    for seed in range(arguments.seeds):
        found.append(trained(arguments, seed))
        plot_learning(found[-1]).savefig(arguments.out / f"seed_{seed}.png")
        values: Any = {path: np.asarray(value) for path, value in found[-1].values.items()}
        np.savez(arguments.out / f"seed_{seed}.npz", **values)
    minutes, memory = (time.perf_counter() - start) / 60, peak_memory() / 2**30
    rows = judged(arguments, found)
    print_table(rows, title="maps of preset edges")
    mean = means(rows, arguments.what)
    print_table(mean, title="means")
    write_csv(arguments.out / "learned_parts.csv", rows)
    weights = sum(np.size(value) for value in found[0].values.values())
    figures = {"weights": weights, "minutes of training": minutes, "GB at most": memory}
    curves = [{"losses": run.losses.tolist(), "validation": run.validation} for run in found]
    write_json(
        arguments.out / "learned_parts.json",
        {"figures": [figures], "curves": curves, "means": mean, "scores": rows},
    )


if __name__ == "__main__":
    main()
