"""`mvedge sweep`: the parameters that score best on some scenes."""

import time
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mvedge_jax.datasets import load_light_field

from ._cluster import connected, extra
from ._common import note, progress_bar
from ._model import FULL, ModelArg, ModelOptions, read_value, settings_of
from ._output import output_folder, write_csv, write_json
from ._paths import scenes_and_out

# Several words after an option, and the option several times.
_Words = Annotated[
    tuple[tuple[str, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="PATH=...")
]


def sweep(
    paths: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SCENES... OUT", help_behavior_hint="(required)"),
    ],
    /,
    *,
    vary: _Words = (),
    choose: _Words = (),
    trials: int = 64,
    batch: int = 4,
    wave: int = 16,
    objective: str = "bad_07",
    journal: Path | None = None,
    prune: bool = False,
    seed: int = 0,
    threads: int = 2,
    workers: int = 0,
    scheduler: str | None = None,
    overwrite: bool = False,
    options: ModelArg = FULL,
) -> None:
    """Looks for the parameters of `mvedge depth` that score best on average over light fields.

    OUT gets best.json (the setting), trials.csv (every setting with its score on every scene),
    sweep.png (history, importances, slices) and report.json. A sweep that was stopped goes on from
    its journal. Example: `mvedge sweep a b OUT --vary refine.precision=0.002:0.02
    dense.trust=0.7:2.8 --choose measurement.views=crosshair,all`.

    Args:
        paths: light fields, then the folder to make.
        vary: numbers as PATH=LOW:HIGH, even in the logarithm, or PATH=LOW:HIGH:linear;
            report.json of `mvedge depth` lists the paths.
        choose: static fields as PATH=A,B,...; each combination is compiled for itself.
        trials: settings to try, those in the journal included.
        batch: settings per call of the compiled program, a few of them side by side.
        wave: settings asked at a time; later ones learn from earlier waves only.
        objective: mse, mae, q25, bad_01, bad_03, bad_07, edge_mse or edge_bad_07.
        journal: file to keep the trials in, OUT.journal by default. Several processes may share it.
        prune: give up, between two scenes, settings that are worse than half of the others.
        seed: of the sampler.
        threads: calls of the program at a time in this process; memory grows with them.
        workers: processes of a Dask cluster on this machine; 0 for none.
        scheduler: address of a Dask scheduler to use instead, such as tcp://host:8786; its workers
            must see the scenes under the same paths.
        overwrite: replace OUT if it is an earlier result of mvedge, with nothing else in it.
        options: of the model; --set holds what is not varied.
    """
    with extra("a sweep needs", "sweep"):
        import optuna

        from mvedge_jax.sweep import Space, plot_sweep, sweep as search
    scenes, out = scenes_and_out(paths)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    space = Space(dict(map(_interval, chain(*vary))), dict(map(_choice, chain(*choose))))
    space.check(options.check())
    _check_truth(scenes)
    journal = out.with_name(f"{out.name}.journal") if journal is None else journal
    before = time.perf_counter()
    with output_folder(out, inputs=scenes, overwrite=overwrite) as folder:
        with connected(workers, scheduler) as client, progress_bar() as bar:
            task = bar.add_task("settings", total=trials)
            found = search(
                [scene.resolve() for scene in scenes],
                space,
                preset=options.preset,
                start=settings_of(options.set),
                trials=trials,
                batch=batch,
                wave=wave,
                objective=objective,
                journal=journal,
                sampler=optuna.samplers.TPESampler(seed=seed, constant_liar=True),
                pruner=optuna.pruners.MedianPruner() if prune else None,
                threads=threads,
                submit=None if client is None else client.submit,
                progress=lambda done, best: bar.update(
                    task, completed=done, description=f"best {objective} {best:.4g}"
                ),
            )
        seconds = time.perf_counter() - before
        _write(folder, found, scenes, objective, journal, seconds, options)
        plot_sweep(found).savefig(folder / "sweep.png")
    first = _number(found.rows[0]["mean"])
    note(f"{objective} {found.value:.4g} (first setting: {first}); written to {out}")
    for name, value in found.study.best_params.items():
        note(f"  {name} = {_number(value)}")


def _check_truth(scenes: Sequence[Path]) -> None:
    """Raises a ValueError for a scene that nothing can be scored by."""
    for scene in scenes:
        if load_light_field(scene).truth is None:
            raise ValueError(f"{scene} has no ground truth, by which a sweep scores.")


def _write(
    folder: Path,
    found: Any,
    scenes: Sequence[Path],
    objective: str,
    journal: Path,
    seconds: float,
    options: ModelOptions,
) -> None:
    """The setting, every trial, and what was done."""
    best = {"preset": options.preset, "setting": found.choices, objective: found.value}
    write_json(folder / "best.json", best)
    columns = list(found.rows[0])
    rows = ([row[column] for column in columns] for row in found.rows)
    write_csv(folder / "trials.csv", columns, rows)
    report = {
        "scenes": [str(scene) for scene in scenes],
        "objective": objective,
        "preset": options.preset,
        "set": settings_of(options.set),
        "settings": len(found.rows),
        "given up": sum(row["state"] == "pruned" for row in found.rows),
        "first setting": found.rows[0]["mean"],
        "best": found.value,
        "seconds": round(seconds, 1),
        "journal": str(journal),
    }
    write_json(folder / "report.json", report)


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _interval(text: str) -> tuple[str, Any]:
    """`PATH=LOW:HIGH` or `PATH=LOW:HIGH:linear`."""
    from mvedge_jax.sweep import Interval

    name, _, ends = text.partition("=")
    parts = ends.split(":")
    linear = len(parts) == 3 and parts[2] == "linear"
    try:
        low, high = (float(part) for part in (parts[:2] if linear else parts))
    except ValueError:
        raise ValueError(
            f"--vary {text}: expected PATH=LOW:HIGH or PATH=LOW:HIGH:linear, with numbers."
        ) from None
    if not np.isfinite((low, high)).all():
        raise ValueError(f"--vary {text}: the ends must be finite.")
    return name, Interval(low, high, log=not linear)


def _choice(text: str) -> tuple[str, tuple]:
    """`PATH=A,B,...`; what reads as a number is one."""
    name, _, values = text.partition("=")
    if not values:
        raise ValueError(f"--choose {text}: expected PATH=A,B,...")
    return name, tuple(map(read_value, values.split(",")))
