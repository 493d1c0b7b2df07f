"""The numbers of preset `"full"`, and a network that weighs its dense labels, learned by gradient.

All numbers of the chain but thresholds are learned, and a network of 25 000 weights: it sees
labels, map and colors around a pixel, and multiplies the odds of the label's weight. It starts as a
factor of 1. Random scenes are learned from and validated on, by parts of 9x9 views: 96 px wide,
they look like crops of views of 190 to 480 px. The best values by validation are written to
`seed_*.npz`; preset `"learned"` has those of one seed. `table_learned.py` judges them by scenes
that were never used.

    python experiments/learned_preset.py --out results/learned_preset
    python experiments/learned_preset.py --what network --scenes 50 --out results/learned_from_50
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np
import optax
import tyro
from _report import peak_memory, print_table, write_json

from mvedge_jax import EdgeDepth
from mvedge_jax.datasets.synthetic import random_scenes
from mvedge_jax.depth.solves import LearnedLabels
from mvedge_jax.learn import Learned, Progress, learn, plot_learning

NETWORK = "dense.network"


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        what: all numbers and the network, or one of the two.
        scenes: random scenes to learn from.
        held: random scenes for validation.
        size: side of the views, px.
        views: views along a side of the grid; odd.
        steps: of Adam.
        batch: scenes per step.
        seeds: one run each, with weights and an order of scenes of its own.
        rate: the learning rate at first, of logarithms of numbers.
        network_rate: that of the weights of the network.
        prior: pull of every value back to its start, see `learn`.
        zoom: how much less than the scene its views show, see `random_light_fields`.
        check_every: steps between validations.
        out: folder for curves, weights and checkpoints.
    """

    what: Literal["both", "numbers", "network"] = "both"
    scenes: int = 1200
    held: int = 32
    size: int = 96
    views: int = 9
    steps: int = 130
    batch: int = 4
    seeds: tuple[int, ...] = (0, 1, 2)
    rate: float = 0.03
    network_rate: float = 0.003
    prior: float = 0.0
    zoom: tuple[float, float] = (2.0, 5.0)
    check_every: int = 26
    out: Path = Path("results/learned_preset")


def trained(arguments: Arguments, seed: int) -> Learned:
    """A run."""

    def drawn(split: random_scenes.Split, count: int) -> Any:
        return random_scenes.random_light_fields(
            shape=(arguments.views, arguments.views, arguments.size, arguments.size),
            split=split,
            count=count,
            disparity_range=(-1.6, 1.6),
            zoom=arguments.zoom,
            views="crosshair",
            key=jax.random.key(0),
        )

    def tell(now: Progress) -> None:
        text = f"seed {seed}, step {now.step}: loss {now.loss:.4f}"
        print(f"{text}, validation {now.validation:.4f}", flush=True)

    scenes = drawn("train", arguments.scenes)
    model = EdgeDepth.for_light_field(scenes[0].without_truth())

    def kind(path: str) -> str:
        return "network" if path.startswith(NETWORK) else "numbers"

    def chosen(path: str) -> bool:
        return "banks" not in path and arguments.what in ("both", kind(path))

    rates = {"numbers": arguments.rate, "network": arguments.network_rate}
    steps: Any = {
        name: optax.adam(optax.cosine_decay_schedule(rate, arguments.steps))
        for name, rate in rates.items()
    }
    return learn(
        model.replace(dense=LearnedLabels.untrained(key=jax.random.key(seed))),
        chosen,
        scenes,
        validation=drawn("validation", arguments.held),
        optimizer=optax.multi_transform(steps, lambda values: {p: kind(p) for p in values}),
        steps=arguments.steps,
        batch=arguments.batch,
        prior=arguments.prior,
        limit=1.0,
        check_every=arguments.check_every,
        checkpoint=arguments.out / f"seed {seed}",
        progress=tell,
        key=jax.random.key(seed),
    )


def main() -> None:
    """Learns with every seed."""
    arguments = tyro.cli(Arguments, description=__doc__)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    curves: list[dict[str, Any]] = []
    for seed in arguments.seeds:
        start = time.perf_counter()
        found = trained(arguments, seed)
        plot_learning(found).savefig(arguments.out / f"seed_{seed}.png")
        values: Any = {
            path: np.asarray(value, np.float16 if path.startswith(NETWORK) else np.float32)
            for path, value in found.values.items()
        }
        np.savez_compressed(arguments.out / f"seed_{seed}.npz", **values)
        rows.append(
            {
                "seed": seed,
                "validation of the rule": found.validation[0][1],
                "validation": min(value for _, value in found.validation),
                "best step": found.best_step,
                "learned": sum(np.size(value) for value in values.values()),
                "minutes": (time.perf_counter() - start) / 60,
                "GiB at most": peak_memory() / 2**30,
            }
        )
        factors = found.factors()
        curves.append(
            {"losses": found.losses.tolist(), "validation": found.validation, "factors": factors}
        )
        print_table(rows, title="training")
        write_json(arguments.out / "learned_preset.json", {"rows": rows, "curves": curves})


if __name__ == "__main__":
    main()
