"""`mvedge batch`: depth of many light fields."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from ._batch_scene import Kind, Options, estimate_of, make, row_of, survey
from ._cluster import connected, outcomes, reason_of
from ._common import SCORES, finite, note, warn
from ._model import FULL, ModelArg
from ._output import MARKER, refuse_inputs, write_csv, write_json
from ._paths import scenes_and_out
from ._slurm import slurm_script
from ._video import COLUMNS


def batch(
    paths: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SCENES... OUT", help_behavior_hint="(required)"),
    ],
    /,
    *,
    views: int | None = None,
    scale: float = 1.0,
    range: tuple[float, float] | None = None,
    all_views: bool = False,
    video: bool = False,
    again: bool = False,
    workers: int = 0,
    scheduler: str | None = None,
    slurm: bool = False,
    options: ModelArg = FULL,
    seed: int = 0,
) -> int:
    """Estimates depth of many light fields, one after the other or on a Dask cluster.

    OUT gets a folder for each light field, with the files of `mvedge depth`, and summary.csv and
    summary.json over all. Light fields of one shape share a program, over the disparity range of
    all of them; `mvedge depth` would choose each range separately. Results that OUT already holds
    are kept; failures are reported at the end and do not stop the others.

    Args:
        paths: light fields, then the folder for the results.
        views: use the central VIEWS x VIEWS views only; odd.
        scale: shrink the views by this factor, at most 1.
        range: lowest and highest disparity of all, px per view step; measured if unknown.
        all_views: measure disparity in all views at the end.
        video: the light fields are the frames of one video, in order. The range is measured in the
            first frame, and again if a later map has problems. The summary says how much maps
            change from frame to frame where the center view does not.
        again: replace existing results.
        workers: processes of a Dask cluster on this machine; 0 for none.
        scheduler: address of a Dask scheduler to use instead, such as tcp://host:8786; its workers
            must see the light fields and OUT under the same paths.
        slurm: only print a script that runs this command on a SLURM cluster.
        options: options of the model.
        seed: seed of the random search of preset thesis.

    Returns:
        The exit code: 0, or 1 if a light field failed.
    """
    scenes, out = scenes_and_out(paths)
    names = _names(scenes)
    _check(views, scale, range)
    options.check(all_views=all_views)
    elsewhere = bool(workers) or scheduler is not None
    if video and (elsewhere or slurm) or slurm and elsewhere:
        raise ValueError("--video, --slurm, and --workers or --scheduler exclude each other.")
    for name in names:
        refuse_inputs((out / name).resolve(), scenes)
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"{out} is a file, expected a folder to write into.")
    asked = Options(views, scale, range, all_views, video, again, options.absolute(), seed)
    if slurm:
        note(slurm_script(_words(scenes, out, asked)))
        return 0
    left, rows = {}, {}
    for name, scene in zip(names, scenes, strict=True):
        if not again and (out / name / MARKER).exists():
            rows[name] = row_of(out / name / "report.json", "there already")
        else:
            left[name] = scene
    with connected(workers, scheduler) as client:
        out.mkdir(parents=True, exist_ok=True)
        if client is not None:  # workers have folders of their own to start from
            left, out = {name: scene.resolve() for name, scene in left.items()}, out.resolve()
        if left:
            earlier = [(scene, out / name) for name, scene in zip(names, scenes, strict=True)]
            before = dict(zip(names[1:], earlier, strict=False)) if video else {}
            rows |= _run(client, left, out, asked, before)
    return _summary({name: rows[name] for name in names}, out)


def _run(
    client: Any,
    scenes: Mapping[str, Path],
    out: Path,
    options: Options,
    before: Mapping[str, tuple[Path, Path]],
) -> dict[str, dict[str, Any]]:
    """Rows of the summary: light fields of one kind after those of another.

    `before` has, for the frames of a video, light field and result of the frame before.
    """
    rows: dict[str, dict[str, Any]] = {}
    kinds: dict[str, Kind] = {}
    ranges: dict[Kind, tuple[float, float]] = {}
    # Frames are read in turn, each with the ranges of those before.
    known = ranges if options.video else {}
    calls = {name: (scene, options, known) for name, scene in scenes.items()}
    for name, found, _ in outcomes(client, survey, calls):
        if isinstance(found, Exception):
            rows[name] = _failed(found)
            continue
        kinds[name], ends = found
        low, high = ranges.get(kinds[name]) or ends
        ranges[kinds[name]] = min(low, ends[0]), max(high, ends[1])
    order = {kind: place for place, kind in enumerate(dict.fromkeys(kinds.values()))}
    calls = {
        name: (name, scenes[name], out, kinds[name], ranges[kinds[name]], options, before.get(name))
        for name in sorted(kinds, key=lambda name: order[kinds[name]])
    }
    try:
        for name, row, workers in outcomes(client, make, calls):
            rows[name] = _failed(row) if isinstance(row, Exception) else row
            if workers:
                rows[name] |= {"worker": workers[-1], "attempt": len(workers)}
                note(f"{name}: {rows[name]['state']} by {workers[-1]}, attempt {len(workers)}")
    finally:
        estimate_of.cache_clear()
    return rows


def _failed(reason: Exception) -> dict[str, Any]:
    return {"state": "failed", "reason": reason_of(reason)}


def _words(scenes: Sequence[Path], out: Path, options: Options) -> list[str]:
    """The command line of a batch, with paths that hold in every folder."""
    words = ["batch", *(str(path.resolve()) for path in (*scenes, out))]
    if options.views is not None:
        words += ["--views", str(options.views)]
    if options.scale != 1:
        words += ["--scale", str(options.scale)]
    if options.range is not None:
        words += ["--range", *map(str, options.range)]
    words += ["--all-views"] * options.all_views + ["--again"] * options.again
    words += ["--preset", options.model.preset]
    if options.model.learned is not None:
        words += ["--model", str(options.model.learned)]
    for setting in options.model.set:
        words += ["--set", setting]
    return [*words, "--seed", str(options.seed)]


def _check(views: int | None, scale: float, ends: tuple[float, float] | None) -> None:
    """Refuses options that would fail for every light field."""
    if views is not None and (views < 3 or views % 2 == 0):
        raise ValueError(f"--views must be odd and at least 3, got {views}.")
    if not 0 < scale <= 1:
        raise ValueError(f"--scale must be in (0, 1], got {scale}.")
    finite(range=ends)
    if ends is not None and not ends[0] < ends[1]:
        raise ValueError(f"--range must be lowest and highest disparity, got {ends}.")


def _names(scenes: Sequence[Path]) -> list[str]:
    """Folders of the results: the scenes' names, with as many parents as make them unique."""
    absolute = [scene.resolve() for scene in scenes]
    if len(set(absolute)) < len(absolute):
        twice = next(s for s, a in zip(scenes, absolute, strict=True) if absolute.count(a) > 1)
        raise ValueError(f"{twice} is given twice.")
    depth = 1
    while True:
        names = ["_".join(scene.parts[-depth:]).strip("/") for scene in absolute]
        if len(set(names)) == len(names):
            return names
        depth += 1


def _summary(rows: dict[str, dict[str, Any]], out: Path) -> int:
    first = ("name", "state", "seconds", "compilation", "converged")
    columns = [*first, *SCORES, "warnings", "reason"]
    if any("unchanged" in row for row in rows.values()):
        columns[len(first) : len(first)] = COLUMNS
    if any("worker" in row for row in rows.values()):
        columns += ["worker", "attempt"]
    named = (
        {"name": name, **row, "warnings": " ".join(row.get("warnings", []))}
        for name, row in rows.items()
    )
    table = ([row.get(column, "") for column in columns] for row in named)
    write_csv(out / "summary.csv", columns, table)
    write_json(out / "summary.json", rows)
    failed = {name: row for name, row in rows.items() if row["state"] == "failed"}
    for name, row in rows.items():
        for doubt in row.get("warnings", []):
            warn(f"{name}: {doubt}")
    for name, row in failed.items():
        warn(f"{name} failed: {row['reason']}")
    note(f"{len(rows) - len(failed)} of {len(rows)} light fields done; summary.csv in {out}")
    return 1 if failed else 0
