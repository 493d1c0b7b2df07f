"""What the experiments that learn by gradient share: the loop, means over scenes, the picture."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import optax
from _scenes import scenes
from matplotlib.figure import Figure

from mvedge_jax import learn
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores


@dataclass(frozen=True)
class Schedule:
    """Options of learning.

    Attributes:
        steps: of Adam.
        batch: scenes per step.
        seeds: runs, each with an order of its own.
        rate: the learning rate at first, in the units of what is learned (logarithms of parameters
            and of gains, taps as they are); it falls to 0 along a cosine.
    """

    steps: int = 40
    batch: int = 2
    seeds: int = 3
    rate: float = 0.05


def of_one_range(names: Sequence[str], *, size: int, views: int = 9) -> dict[str, LightField]:
    """Rendered scenes with the widest of their ranges, so that one program serves them all."""
    fields = {name: field.crop_views(views) for name, field in scenes(None, names, size=size)}
    ranged = (field.renamed("light field") for field in learn.of_one_range(list(fields.values())))
    return dict(zip(fields, ranged, strict=True))


def learned_by_seeds(
    model: Any,
    what: Sequence[str] | Callable[[str], bool],
    fields: Sequence[LightField],
    schedule: Schedule,
    *,
    loss: Callable[[Any, LightField], jax.Array],
    limit: float = float("inf"),
) -> list[learn.Learned]:
    """What Adam ends at for every seed.

    Args:
        model: see `learn.learn`.
        what: leaves that are learned, likewise.
        fields: the scenes, drawn in an order of the seed's.
        schedule: of Adam.
        loss: of a result and its scene.
        limit: of the norm of a scene's gradient; longer ones are shortened.
    """

    def run(seed: int) -> learn.Learned:
        def tell(now: learn.Progress) -> None:
            print(f"seed {seed}, step {now.step}: loss {now.loss:.5f}", flush=True)

        return learn.learn(
            model,
            what,
            fields,
            loss=loss,
            optimizer=optax.adam(optax.cosine_decay_schedule(schedule.rate, schedule.steps)),
            steps=schedule.steps,
            batch=schedule.batch,
            limit=limit,
            progress=tell,
            key=jax.random.key(seed),
        )

    return [run(seed) for seed in range(schedule.seeds)]


def scored(
    estimate: Callable[[Any, LightField], jax.Array],
    cases: Mapping[str, Any],
    fields: Mapping[str, LightField],
    learned_from: Sequence[str],
    what: str,
) -> list[dict[str, Any]]:
    """A row per scene and case: the scores of its map.

    Args:
        estimate: the map of what was learned and of a scene.
        cases: what was learned, and where it started, by name.
        fields: the scenes.
        learned_from: the names of those that were seen.
        what: the column of the case.
    """
    rows = []
    for name, field in fields.items():
        truth, use = field.truth, "learned from" if name in learned_from else "unseen"
        assert truth is not None
        for label, case in cases.items():
            found = depth_scores(estimate(case, field), truth.disparity, mask=truth.valid)
            columns = {
                "MSE*100": float(found.mse),
                "Q25*100": float(found.q25),
                "BP(.01)": float(found.bad_01),
                "BP(.03)": float(found.bad_03),
                "BP(.07)": float(found.bad_07),
            }
            rows.append({"scene": name, "use": use, what: label, **columns})
    return rows


def means(rows: Sequence[dict[str, Any]], what: str) -> list[dict[str, Any]]:
    """Mean scores over the scenes of either use, for the defaults and for every seed."""
    found = []
    for use in dict.fromkeys(row["use"] for row in rows):
        for label in dict.fromkeys(row[what] for row in rows):
            mine = [row for row in rows if (row["use"], row[what]) == (use, label)]
            columns = [name for name in mine[0] if name not in ("scene", "use", what)]
            mean = {name: sum(row[name] for row in mine) / len(mine) for name in columns}
            found.append({"use": use, what: label, **mean})
    return found


def plot_learning(
    losses: Sequence[Sequence[float]],
    rows: Sequence[dict[str, Any]],
    what: str,
    columns: tuple[str, str],
    *,
    over: tuple[str, str] = ("step of Adam", "loss of the mini-batch"),
) -> Figure:
    """The loss curve, and two scores before and after per scene; a seed has one color."""
    figure = Figure(figsize=(15, 4.2), layout="constrained")
    curve, *axes = figure.subplots(1, 3)
    # What was not learned comes first.
    before = len(dict.fromkeys(row[what] for row in rows)) - len(losses)
    for seed, values in enumerate(losses):
        curve.plot(values, "o-", markersize=3, color=f"C{before + seed}")
    curve.set(xlabel=over[0], ylabel=over[1])
    names = list(dict.fromkeys(row["scene"] for row in rows))
    titles = {row["scene"]: f"{row['scene']}\n{row['use'].split()[0]}" for row in rows}
    for axis, column in zip(axes, columns, strict=True):
        labels = list(dict.fromkeys(row[what] for row in rows))
        for k, label in enumerate(labels):
            heights = [row[column] for row in rows if row[what] == label]
            shift, width = 0.8 * k / len(labels) - 0.3, 0.8 / len(labels)
            axis.bar([place + shift for place in range(len(names))], heights, width, label=label)
        axis.set_xticks(range(len(names)), [titles[name] for name in names], fontsize=7)
        axis.set(ylabel=column)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure
