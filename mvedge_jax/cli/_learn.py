"""`mvedge learn`: numbers of the model learned by gradient from scenes with truth."""

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import optax
import tyro

from mvedge_jax.datasets import load_light_field
from mvedge_jax.datasets.synthetic.random_scenes import random_light_fields
from mvedge_jax.learn import (
    Learned,
    Progress,
    chosen,
    learn as learn_from,
    of_one_range,
    plot_learning,
)
from mvedge_jax.lightfield import LightField

from ._common import note, progress_bar, stage
from ._model import FULL, ModelArg, settings_of
from ._output import output_folder, write_csv, write_json
from ._paths import scenes_and_out

_Fields = Sequence[LightField]


def learn(
    paths: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="[SCENES...] OUT", help_behavior_hint="(OUT is required)"),
    ],
    /,
    *,
    what: tuple[str, ...] = ("smoothness", "refine"),
    steps: int = 200,
    batch: int = 2,
    rate: float = 0.02,
    prior: float = 0.0,
    limit: float = 1.0,
    validation: int = 0,
    check_every: int = 20,
    patience: int | None = None,
    random: int = 64,
    size: int = 96,
    views: int = 5,
    range: tuple[float, float] = (-2.0, 2.0),
    zoom: tuple[float, float] = (1.0, 1.0),
    checkpoint: Path | None = None,
    seed: int = 0,
    overwrite: bool = False,
    options: ModelArg = FULL,
) -> None:
    """Learns numbers of the model of `mvedge depth` from light fields with truth, by gradient.

    Without SCENES, random synthetic ones are rendered. OUT gets learned.json, which `mvedge depth
    --model OUT/learned.json` and its like take, curves.csv, learning.png and report.json. A run
    that was stopped goes on from its checkpoint. Example: `mvedge learn OUT --what smoothness
    refine.precision --random 200 --validation 20`.

    Args:
        paths: light fields of one size with truth, then the folder to make; OUT alone for random
            scenes.
        what: paths of numbers or of whole parts; report.json of `mvedge depth` lists them.
        steps: minibatches.
        batch: scenes of a minibatch.
        rate: of Adam at first, about the relative change of a number in a step; it falls to 0.
        prior: pull back to the start, see the documentation of `learn`.
        limit: of the norm of a scene's gradient.
        validation: scenes held out, whose loss decides which numbers are kept: the last ones of
            SCENES, or random ones besides; 0 for none.
        check_every: steps between validations, and between checkpoints.
        patience: validations without a better one after which learning stops; never by default.
        random: number of random scenes.
        size: side of the views of random scenes, px.
        views: views along a side of the grid of random scenes; odd.
        range: of the disparities of random scenes, px per view step.
        zoom: least and largest factor by which views show less than a random scene, so that small
            views look like crops of larger ones.
        checkpoint: folder of the checkpoint, OUT.checkpoint by default.
        seed: of random scenes, and of their order.
        overwrite: replace OUT if it is an earlier result of mvedge, with nothing else in it.
        options: of the model.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"--rate must be positive, got {rate}.")
    if steps < 1:
        raise ValueError(f"--steps must be at least 1, got {steps}.")
    if validation < 0:
        raise ValueError(f"--validation must not be negative, got {validation}.")
    chosen(options.check(), what)
    given, out = scenes_and_out(paths) if len(paths) > 1 else ([], *map(Path, paths))
    shape, key = (views, views, size, size), jax.random.key(seed)
    fields, held = (
        _loaded(given, validation)
        if given
        else _random(random, validation, shape=shape, disparity_range=range, zoom=zoom, key=key)
    )
    with stage("choosing sizes"):
        model = options.model(fields[0].without_truth())
    folder_of = out.with_name(f"{out.name}.checkpoint") if checkpoint is None else checkpoint
    choices: dict[str, Any] = {"steps": steps, "batch": batch, "prior": prior, "limit": limit}
    choices |= {"check_every": check_every, "patience": patience}
    before = time.perf_counter()
    with output_folder(out, inputs=given, overwrite=overwrite) as folder:
        with _telling(steps, checked=held is not None) as tell:
            adam = optax.adam(optax.cosine_decay_schedule(rate, steps))
            options_of = {"optimizer": adam, "checkpoint": folder_of, "progress": tell, "key": key}
            found = learn_from(model, what, fields, validation=held, **choices, **options_of)
        report = {
            "scenes": [str(scene) for scene in given]
            or f"{random} random scenes of {shape}, disparities {range}, zoom {zoom}",
            "validation scenes": len(held or ()),
            "what": list(found.values),
            "rate": rate,
            **choices,
            "seed": seed,
            "best step": found.best_step,
            "seconds": round(time.perf_counter() - before, 1),
            "checkpoint": str(folder_of),
            "set": settings_of(options.set),
        }
        _write(folder, found, options.preset, report)
    _conclude(found, out)


@contextlib.contextmanager
def _telling(steps: int, *, checked: bool) -> Iterator[Callable[[Progress], None]]:
    """A progress bar, and what moves it on."""
    with progress_bar() as bar:
        task = bar.add_task("steps", total=steps)

        def tell(now: Progress) -> None:
            validation = f", validation {now.validation:.4g}" if checked else ""
            bar.update(task, completed=now.step, description=f"loss {now.loss:.4g}{validation}")

        yield tell


def _loaded(paths: Sequence[Path], held: int) -> tuple[_Fields, _Fields | None]:
    """Light fields to learn from, and those held out; all with one range."""
    if held >= len(paths):
        raise ValueError(f"--validation {held} leaves none of {len(paths)} scenes to learn from.")
    with stage(f"reading {len(paths)} light fields"):
        fields = [load_light_field(path) for path in paths]
    for path, field in zip(paths, fields, strict=True):
        if field.truth is None:
            raise ValueError(f"{path} has no ground truth to learn from.")
    ranged = of_one_range(fields)
    return ranged[: len(ranged) - held], ranged[len(ranged) - held :] or None


def _random(count: int, held: int, **options: Any) -> tuple[_Fields, _Fields | None]:
    """Random scenes to learn from, and others that are held out."""
    fields = random_light_fields(count=count, **options)
    if not held:
        return fields, None
    return fields, random_light_fields(split="validation", count=held, **options)


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


def _conclude(found: Learned, out: Path) -> None:
    """Prints the curves' ends and what moved most."""
    tenth = max(len(found.losses) // 10, 1)
    ends = (found.losses[:tenth].mean(), found.losses[-tenth:].mean())
    note(f"loss {ends[0]:.4g} -> {ends[1]:.4g} (first and last tenth); written to {out}")
    if found.validation:
        checks = dict(found.validation)
        best = checks.get(found.best_step, float("nan"))
        note(f"validation {checks[0]:.4g} -> {best:.4g}, step {found.best_step}")
    factors = found.factors()
    for path in sorted(factors, key=lambda p: -abs(np.log(factors[p])))[:12]:
        note(f"  {path} = {float(found.values[path]):.4g} (x {factors[path]:.3g})")
