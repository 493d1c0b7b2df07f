"""`mvedge learn`: numbers of the model learned by gradient from scenes with truth."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mvedge_jax.learn import chosen

from ._cluster import connected, outcomes, reason_of
from ._common import note, warn
from ._learn_seed import Asked, Scenes, learn_seed
from ._model import FULL, ModelArg
from ._output import refuse_inputs, write_csv, write_json
from ._paths import scenes_and_out

_COLUMNS = (
    "state",
    "seed",
    "best step",
    "loss before",
    "loss after",
    "validation before",
    "validation after",
    "seconds",
)


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
    seeds: tuple[int, ...] = (0,),
    workers: int = 0,
    scheduler: str | None = None,
    overwrite: bool = False,
    options: ModelArg = FULL,
) -> int:
    """Learns numbers of the model of `mvedge depth` from light fields with truth, by gradient.

    Without SCENES, random synthetic ones are rendered. OUT gets learned.json, which `mvedge depth
    --model OUT/learned.json` and its like take, curves.csv, learning.png and report.json. A run
    that was stopped goes on from its checkpoint. Of several seeds, OUT gets a folder each, and
    summary.csv and summary.json over all; those that are there already are kept. Example: `mvedge
    learn OUT --what smoothness refine.precision --random 200 --validation 20`.

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
        checkpoint: folder of the checkpoint, OUT.checkpoint by default; of several seeds, a
            folder for their checkpoints.
        seeds: of random scenes, and of their order; each is a run of its own.
        workers: processes of a Dask cluster on this machine that take the seeds; 0 for none.
        scheduler: address of a Dask scheduler to use instead, such as tcp://host:8786; its workers
            must see SCENES and OUT under the same paths.
        overwrite: replace results of mvedge that have nothing else in their folder.
        options: of the model.

    Returns:
        The exit code: 0, or 1 if one of several seeds failed.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"--rate must be positive, got {rate}.")
    if steps < 1:
        raise ValueError(f"--steps must be at least 1, got {steps}.")
    if validation < 0:
        raise ValueError(f"--validation must not be negative, got {validation}.")
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(f"--seeds must be different numbers, at least one, got {seeds}.")
    chosen(options.check(), what)
    given, out = scenes_and_out(paths) if len(paths) > 1 else ([], *map(Path, paths))
    if given and validation >= len(given):
        raise ValueError(
            f"--validation {validation} leaves none of {len(given)} scenes to learn from."
        )
    choices: dict[str, Any] = {"steps": steps, "batch": batch, "prior": prior, "limit": limit}
    choices |= {"check_every": check_every, "patience": patience}
    kept = out.with_name(f"{out.name}.checkpoint") if checkpoint is None else checkpoint
    # Workers have folders of their own to start from.
    files, out, kept = tuple(path.absolute() for path in given), out.absolute(), kept.absolute()
    scenes = Scenes(files, validation, random, (views, views, size, size), range, zoom)
    asked = Asked(scenes, what, rate, choices, options.absolute(), overwrite, len(seeds) > 1)
    if len(seeds) == 1:
        calls = {"": (asked, seeds[0], out, kept)}
    else:
        refuse_inputs(out.resolve(), given)
        if out.exists() and not out.is_dir():
            raise FileExistsError(f"{out} is a file, expected a folder to write into.")
        out.mkdir(parents=True, exist_ok=True)
        names = [f"seed_{seed}" for seed in seeds]
        calls = {
            name: (asked, seed, out / name, kept / name)
            for name, seed in zip(names, seeds, strict=True)
        }
    return _run(calls, out, workers, scheduler)


def _run(
    calls: Mapping[str, tuple[Asked, int, Path, Path]],
    out: Path,
    workers: int,
    scheduler: str | None,
) -> int:
    """Runs every seed."""
    rows: dict[str, dict[str, Any]] = {name: {} for name in calls}
    with connected(workers, scheduler) as client:
        for name, row, at in outcomes(client, learn_seed, calls):
            if isinstance(row, Exception):
                if len(calls) == 1:
                    raise row
                row = {"state": "failed", "reason": reason_of(row)}
            rows[name] = row | ({"worker": at[-1], "attempt": len(at)} if at else {})
            _conclude(name, rows[name], calls[name][2])
    return _summary(rows, out) if len(calls) > 1 else 0


def _summary(rows: Mapping[str, Any], out: Path) -> int:
    """Writes summary.csv and summary.json; 1 if a seed failed, else 0."""
    columns = [*_COLUMNS, "reason", "worker", "attempt"]
    table = ([name, *(row.get(column, "") for column in columns)] for name, row in rows.items())
    write_csv(out / "summary.csv", ["name", *columns], table)
    write_json(out / "summary.json", rows)
    failed = [name for name, row in rows.items() if row["state"] == "failed"]
    note(f"{len(rows) - len(failed)} of {len(rows)} seeds done; summary.csv in {out}")
    return 1 if failed else 0


def _conclude(name: str, row: Mapping[str, Any], out: Path) -> None:
    """Prints the ends of a run's curves and what moved most."""
    whose = f"{name}: " if name else ""
    if "reason" in row:
        warn(f"{whose}{row['state']}: {row['reason']}")
        return
    ends = f"loss {row['loss before']:.4g} -> {row['loss after']:.4g} (first and last tenth)"
    note(f"{whose}{ends}; written to {out}")
    if row["validation before"] is not None:
        checks = f"validation {row['validation before']:.4g} -> {row['validation after']:.4g}"
        note(f"{whose}{checks}, step {row['best step']}")
    factors, numbers = row["factors"], row["numbers"]
    for path in sorted(factors, key=lambda p: -abs(np.log(factors[p])))[:12]:
        note(f"  {path} = {float(numbers[path]):.4g} (x {factors[path]:.3g})")
