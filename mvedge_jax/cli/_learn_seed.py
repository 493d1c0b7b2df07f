"""One run of `mvedge learn`, in this process or on a worker of a Dask cluster."""

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import optax

from mvedge_jax.datasets import load_light_field
from mvedge_jax.datasets.synthetic.random_scenes import random_light_fields
from mvedge_jax.learn import (
    Learned,
    Progress,
    learn as learn_from,
    of_one_range,
    plot_learning,
)
from mvedge_jax.lightfield import LightField

from ._common import progress_bar, stage
from ._model import ModelOptions, settings_of
from ._output import MARKER, output_folder, write_csv, write_json
from ._source import read_json

_Fields = Sequence[LightField]


class Scenes(NamedTuple):
    """What is learned from; the attributes are options of `mvedge learn`.

    Attributes:
        given: light fields; none for random scenes.
        validation: how many are held out.
        random: number of random scenes.
        shape: of random scenes, `(v, u, y, x)`.
        range: of their disparities.
        zoom: of their parts.
    """

    given: tuple[Path, ...]
    validation: int
    random: int
    shape: tuple[int, int, int, int]
    range: tuple[float, float]
    zoom: tuple[float, float]

    def of(self, seed: int) -> tuple[_Fields, _Fields | None]:
        """Light fields to learn from, and those held out."""
        if self.given:
            return self._loaded()
        options = {"shape": self.shape, "disparity_range": self.range, "zoom": self.zoom}
        options |= {"key": jax.random.key(seed)}
        fields = random_light_fields(count=self.random, **options)
        if not self.validation:
            return fields, None
        return fields, random_light_fields(split="validation", count=self.validation, **options)

    def _loaded(self) -> tuple[_Fields, _Fields | None]:
        """Light fields of files, all with one range."""
        left = len(self.given) - self.validation
        with stage(f"reading {len(self.given)} light fields"):
            fields = [load_light_field(path) for path in self.given]
        for path, field in zip(self.given, fields, strict=True):
            if field.truth is None:
                raise ValueError(f"{path} has no ground truth to learn from.")
        ranged = of_one_range(fields)
        return ranged[:left], ranged[left:] or None

    @property
    def told(self) -> list[str] | str:
        """What the report says of them."""
        if self.given:
            return [str(scene) for scene in self.given]
        ends = f"disparities {self.range}, zoom {self.zoom}"
        return f"{self.random} random scenes of {self.shape}, {ends}"


class Asked(NamedTuple):
    """What a run is told.

    Attributes:
        scenes: what is learned from.
        what: paths of numbers or of whole parts.
        rate: of Adam at first.
        choices: arguments of `learn`.
        model: options of the model.
        overwrite: replace an earlier result.
        several: there are other seeds; a result of this one that is there already is kept.
    """

    scenes: Scenes
    what: tuple[str, ...]
    rate: float
    choices: dict[str, Any]
    model: ModelOptions
    overwrite: bool
    several: bool


def learn_seed(asked: Asked, seed: int, out: Path, checkpoint: Path) -> dict[str, Any]:
    """Learns from one seed and writes `out`.

    Args:
        asked: what to do.
        seed: of random scenes, and of their order.
        out: the folder to make.
        checkpoint: folder that a stopped run goes on from.

    Returns:
        The row of the summary.
    """
    if asked.several and not asked.overwrite and (out / MARKER).exists():
        return _row(out, "there already")
    fields, held = asked.scenes.of(seed)
    with stage("choosing sizes"):
        model = asked.model.model(fields[0].without_truth())
    before, steps = time.perf_counter(), asked.choices["steps"]
    inputs = asked.scenes.given
    with output_folder(out, inputs=inputs, overwrite=asked.overwrite) as folder:
        with _telling(steps, checked=held is not None) as tell:
            adam = optax.adam(optax.cosine_decay_schedule(asked.rate, steps))
            options = {"optimizer": adam, "checkpoint": checkpoint, "progress": tell}
            options |= {"key": jax.random.key(seed), **asked.choices}
            found = learn_from(model, asked.what, fields, validation=held, **options)
        tenth, checks = max(len(found.losses) // 10, 1), dict(found.validation)
        report = {
            "scenes": asked.scenes.told,
            "validation scenes": len(held or ()),
            "what": list(found.values),
            "rate": asked.rate,
            **asked.choices,
            "seed": seed,
            "best step": found.best_step,
            "loss": [float(part.mean()) for part in (found.losses[:tenth], found.losses[-tenth:])],
            "validation": [checks[0], checks[found.best_step]] if checks else None,
            "seconds": round(time.perf_counter() - before, 1),
            "checkpoint": str(checkpoint),
            "set": settings_of(asked.model.set),
        }
        _write(folder, found, asked.model.preset, report)
    return _row(out, "done")


def _row(out: Path, state: str) -> dict[str, Any]:
    """What the summary says of a finished run."""
    try:
        report, learned = read_json(out / "report.json"), read_json(out / "learned.json")
        row = {"state": state, "seed": report["seed"], "best step": report["best step"]}
        row["loss before"], row["loss after"] = report["loss"]
        row["validation before"], row["validation after"] = report["validation"] or (None, None)
        # Whole networks among them would make the summary large.
        numbers = {path: learned["numbers"][path] for path in learned["factors"]}
        row |= {"seconds": report["seconds"], "factors": learned["factors"], "numbers": numbers}
        return row
    except (OSError, ValueError, KeyError, TypeError):
        return {"state": state, "reason": f"{out} is not readable"}


@contextlib.contextmanager
def _telling(steps: int, *, checked: bool) -> Iterator[Callable[[Progress], None]]:
    """A progress bar, and what moves it on."""
    with progress_bar() as bar:
        task = bar.add_task("steps", total=steps)

        def tell(now: Progress) -> None:
            validation = f", validation {now.validation:.4g}" if checked else ""
            bar.update(task, completed=now.step, description=f"loss {now.loss:.4g}{validation}")

        yield tell


def _write(folder: Path, found: Learned, preset: str, report: dict[str, Any]) -> None:
    """What was learned, the curves, and what was done."""
    numbers = {path: np.asarray(value).tolist() for path, value in found.values.items()}
    learned = {"preset": preset, "factors": found.factors(), "numbers": numbers}
    write_json(folder / "learned.json", learned)
    checks = dict(found.validation)
    losses = ["", *found.losses.tolist()]
    rows = ([step, loss, checks.get(step, "")] for step, loss in enumerate(losses))
    write_csv(folder / "curves.csv", ["step", "loss", "validation"], rows)
    plot_learning(found).savefig(folder / "learning.png")
    write_json(folder / "report.json", report)
