"""Filters learned by gradient in the thesis' chain, against the oriented Prewitt filters.

Adam goes through filters, lines, entropy search and joint filter to the disparities of the points.
Small synthetic scenes are learned from, in mini-batches that each seed draws, and others are only
measured. The loss is the mean of `log(1 + (error / 0.03 px)²)` over the points, where the error is
that to the best of the 3x3 pixels around. What is learned, for either arm: the gain of each filter,
the weight of each view, and a symmetric kernel along the rows that all filters share. Taps that
move each for themselves fall apart: thousands of numbers, of which a scene needs few.

The thesis takes the disparity of the filter that answers most; a derivative needs the vertex
between filters. Both are in the table, before anything is learned.

    python experiments/learn_bank.py --out results/learn_bank
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from _learning import Schedule, learned_by_seeds, means, of_one_range, plot_learning
from _report import print_table, write_csv, write_json
from jax import Array

from mvedge_jax import lean_jit
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges import EdgePoints
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.epi import FilterBank
from mvedge_jax.lightfield import LightField


@dataclass(frozen=True)
class Arguments(Schedule):
    """Options.

    Attributes:
        learn: scenes to learn from.
        unseen: scenes to measure besides.
        size: side of the views, px.
        rate: the learning rate at first, of logarithms and of the kernel; it falls to 0 along a
            cosine.
        limit: of the norm of a scene's gradient: where lines swap it has no meaning.
        out: folder for the table, the curve and the banks.
    """

    learn: tuple[str, ...] = ("edges", "demo", "thin", "wide")
    unseen: tuple[str, ...] = ("slanted", "crossing", "specular")
    size: int = 96
    rate: float = 0.012
    limit: float = 1.0
    out: Path = Path("results/learn_bank")


class Change(NamedTuple):
    """Of the filters of an arm.

    Attributes:
        gain: logarithm, of each filter.
        view: logarithm of the weight of each view.
        blur: the outer half of a symmetric kernel along the rows, whose middle is 1.
    """

    gain: Array
    view: Array
    blur: Array


class Points(eqx.Module):
    """The points of a chain whose filters are changed.

    Attributes:
        changes: of the filters of either arm.
        banks: the filters before.
        chain: with the thesis' edges.
    """

    changes: tuple[Change, ...]
    banks: tuple[FilterBank, ...]
    chain: EdgeDepth

    def changed(self) -> tuple[FilterBank, ...]:
        """The filters of either arm."""
        return tuple(_changed(*pair) for pair in zip(self.banks, self.changes, strict=True))

    def __call__(self, field: LightField, *, key: Array | None = None) -> EdgePoints:
        """Points; the entropy search draws alike every time."""
        del key
        model = self.chain.replace({"edges.banks": self.changed()})
        return multiview_edges(field, model, key=jax.random.key(0)).points


def errors(points: EdgePoints, field: LightField) -> tuple[Array, Array]:
    """Errors of points, and which slots have a point."""
    assert field.truth is not None
    return _errors(points.xy, points.disparity, field.truth.disparity), points.valid


def loss(points: EdgePoints, field: LightField) -> Array:
    """What is lowered: see above."""
    error, valid = errors(points, field)
    return jnp.where(valid, jnp.log1p((error / 0.03) ** 2), 0).sum() / valid.sum()


def main() -> None:
    """Learns, measures and draws."""
    arguments = tyro.cli(Arguments, description=__doc__)
    fields = of_one_range(arguments.learn + arguments.unseen, size=arguments.size)
    one = next(iter(fields.values()))
    thesis = EdgeDepth.for_light_field(one, preset="thesis")
    between = thesis.replace({"edges.lines.interpolate": True})
    assert isinstance(thesis.edges, ThesisEdges)
    banks = thesis.edges.prewitt(one.views.shape, one.views.dtype)
    first = tuple(_nothing(bank) for bank in banks)
    start = Points(first, tuple(banks), between)
    chosen = [fields[name] for name in arguments.learn]
    runs = learned_by_seeds(start, ["changes"], chosen, arguments, loss=loss, limit=arguments.limit)
    cases = [("thesis", Points(first, tuple(banks), thesis)), ("Prewitt", start)]
    cases += [(f"seed {k}", run.model) for k, run in enumerate(runs)]
    measured = lean_jit(lambda field, model: errors(model(field.without_truth()), field))
    rows = []
    for name, field in fields.items():
        for label, model in cases:
            error, valid = (np.asarray(a) for a in measured(field, model))
            use = "learned from" if name in arguments.learn else "unseen"
            rows.append({"scene": name, "use": use, "bank": label, **_scores(error[valid])})
    title = f"points of the thesis' chain, {arguments.steps} steps of Adam at {arguments.rate}"
    print_table(rows, title=title)
    mean = means(rows, "bank")
    print_table(mean, title="means over scenes")
    losses = [run.losses.tolist() for run in runs]
    write_csv(arguments.out / "learn_bank.csv", rows)
    write_json(arguments.out / "learn_bank.json", {"losses": losses, "means": mean, "scores": rows})
    for seed, run in enumerate(runs):
        taps = [bank.taps for bank in run.model.changed()]
        across, down = (np.asarray(t) for t in taps)
        np.savez(arguments.out / f"seed_{seed}.npz", across=across, down=down)
    figure = plot_learning(losses, rows, "bank", ("median", "> .07 %"))
    figure.savefig(arguments.out / "learn_bank.png")


def _nothing(bank: FilterBank) -> Change:
    """The change that leaves a bank as it is."""
    filters, views, _ = bank.taps.shape
    dtype = bank.taps.dtype
    return Change(jnp.zeros(filters, dtype), jnp.zeros(views, dtype), jnp.zeros(3, dtype))


def _changed(bank: FilterBank, change: Change) -> FilterBank:
    reach, width = change.blur.size, bank.taps.shape[2]
    kernel = jnp.concatenate([change.blur[::-1], jnp.ones(1, change.blur.dtype), change.blur])
    padded = jnp.pad(bank.taps, ((0, 0), (0, 0), (reach, reach)))
    blurred = sum(kernel[k] * padded[..., k : k + width] for k in range(kernel.size))
    taps = jnp.exp(change.gain)[:, None, None] * jnp.exp(change.view)[:, None] * blurred
    return FilterBank(bank.disparity, taps)


def _errors(xy: Array, disparity: Array, truth: Array) -> Array:
    """Of points, to the best of the 3x3 pixels around: a point sits between two surfaces."""
    height, width = truth.shape
    padded = jnp.pad(truth, 1, mode="edge")
    x = jnp.clip(jnp.round(xy[:, 0]).astype(jnp.int32), 0, width - 1)
    y = jnp.clip(jnp.round(xy[:, 1]).astype(jnp.int32), 0, height - 1)
    around = [padded[y + dy, x + dx] for dy in range(3) for dx in range(3)]
    return jnp.min(jnp.abs(jnp.stack(around) - disparity[None]), axis=0)


def _scores(error: np.ndarray) -> dict[str, float]:
    return {
        "points": len(error),
        "median": float(np.median(error)),
        "> .03 %": 100 * float((error > 0.03).mean()),
        "> .07 %": 100 * float((error > 0.07).mean()),
        "> .5 %": 100 * float((error > 0.5).mean()),
    }


if __name__ == "__main__":
    main()
