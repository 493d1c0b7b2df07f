"""`mvedge batch`: depth of many light fields."""

import csv
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import tyro

from mvedge_jax.depth import DepthResult, EdgeDepth, estimate_depth
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField

from ._common import compiled, finite, missing_views, note, stage, warn
from ._depth import depth_report, score_depth, write_depth
from ._model import FULL, ModelArg, ModelOptions, reads_all_views
from ._output import MARKER, output_folder, refuse_inputs, write_json
from ._paths import scenes_and_out
from ._source import read_json, read_scene, source_of

_SCORES = ("mse", "q25", "bad_01", "bad_03", "bad_07")


class _Kind(NamedTuple):
    """Light fields that share a program: shape, precision and extent of their views.

    Attributes:
        shape: shape of the views.
        dtype: dtype of the views.
        farthest: see `LightField.farthest`; None for a regular grid.
    """

    shape: tuple[int, ...]
    dtype: str
    farthest: int | None


class _Options(NamedTuple):
    """Options of reading and estimating light fields."""

    views: int | None
    scale: float
    all_views: bool
    video: bool
    model: ModelOptions
    seed: int


def batch(
    paths: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENES... OUT")
    ],
    /,
    *,
    views: int | None = None,
    scale: float = 1.0,
    range: tuple[float, float] | None = None,
    all_views: bool = False,
    video: bool = False,
    again: bool = False,
    options: ModelArg = FULL,
    seed: int = 0,
) -> int:
    """Estimates depth of many light fields, one after the other.

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
            first frame, and again if a later map has problems.
        again: replace existing results.
        options: options of the model.
        seed: seed of the random search of preset thesis.

    Returns:
        The exit code: 0, or 1 if a light field failed.
    """
    scenes, out = scenes_and_out(paths)
    names = _names(scenes)
    _check(views, scale, range)
    options.check(all_views=all_views)
    for name in names:
        refuse_inputs((out / name).resolve(), scenes)
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"{out} is a file, expected a folder to write into.")
    out.mkdir(parents=True, exist_ok=True)
    # A given range is kept.
    asked = _Options(views, scale, all_views, video and range is None, options, seed)
    rows: dict[str, dict[str, Any]] = {}
    kinds: dict[_Kind, list[tuple[str, Path]]] = {}
    ranges: dict[_Kind, tuple[float, float]] = {}
    for name, scene in zip(names, scenes, strict=True):
        if not again and (out / name / MARKER).exists():
            rows[name] = _row(out / name / "report.json", "there already")
            continue
        try:
            with stage(f"reading {scene}"):
                found = read_scene(scene, views=views, scale=scale)[0].without_truth()
            farthest = None if found.positions is None else found.farthest
            kind = _Kind(found.views.shape, str(found.views.dtype), farthest)
            ends = range or (ranges.get(kind) if asked.video else None) or scene_range(found)
        except (ValueError, OSError, MemoryError) as reason:
            rows[name] = {"state": "failed", "reason": str(reason)}
            continue
        low, high = ranges.get(kind, ends)
        ranges[kind] = min(low, ends[0]), max(high, ends[1])
        kinds.setdefault(kind, []).append((name, scene))
    for kind, members in kinds.items():
        _run(members, kind, ranges[kind], rows, out, asked)
        # A program holds some 1300 memory maps, of which Linux allows 65530.
        jax.clear_caches()
    return _summary({name: rows[name] for name in names}, out)


def _check(views: int | None, scale: float, ends: tuple[float, float] | None) -> None:
    """Refuses options that would fail for every light field."""
    if views is not None and (views < 3 or views % 2 == 0):
        raise ValueError(f"--views must be odd and at least 3, got {views}.")
    if not 0 < scale <= 1:
        raise ValueError(f"--scale must be in (0, 1], got {scale}.")
    finite(range=ends)
    if ends is not None and not ends[0] < ends[1]:
        raise ValueError(f"--range must be lowest and highest disparity, got {ends}.")


def _run(
    members: Sequence[tuple[str, Path]],
    kind: _Kind,
    ends: tuple[float, float],
    rows: dict[str, dict[str, Any]],
    out: Path,
    options: _Options,
) -> None:
    """Light fields of one shape, through one program."""
    estimate = _Estimate(kind, options, ends)
    for name, scene in members:
        try:
            with stage(f"reading {scene}"):
                found, said = read_scene(scene, views=options.views, scale=options.scale)
            result, model, seconds = estimate(found, name)
            # `output_folder` refuses anything but an earlier result.
            with output_folder(out / name, inputs=[scene], overwrite=True) as folder:
                report = depth_report(found, result, seconds)
                report |= options.model.described(model) | {"seed": options.seed}
                write_depth(folder, found, result)
                report["scores"] = score_depth(folder, found.truth, result)
                report["source"] = source_of(scene, views=options.views, scale=options.scale)
                report["warnings"] = [
                    *said,
                    *result.problems(),
                    *(missing_views(found) if reads_all_views(model) else []),
                ]
                write_json(folder / "report.json", report)
            rows[name] = _row(out / name / "report.json", "done")
        except (ValueError, OSError, MemoryError) as reason:
            rows[name] = {"state": "failed", "reason": str(reason)}


class _Estimate:
    """Depth of light fields of one kind; compiled for the first, and again for wider ranges."""

    def __init__(self, kind: _Kind, options: _Options, ends: tuple[float, float]):
        self._kind, self._options, self._ends = kind, options, ends
        self._key = jax.random.key(options.seed)
        self._program: tuple[Any, EdgeDepth] | None = None

    def __call__(
        self, light_field: LightField, name: str
    ) -> tuple[DepthResult, EdgeDepth, dict[str, float]]:
        """Depth, its model, and the seconds of the estimate."""
        views = _anonymous(light_field)
        start = time.perf_counter()
        program, model = self._compiled(views)
        ready = time.perf_counter()
        with stage(f"estimating depth of {name}"):
            result = jax.block_until_ready(program(views, model, key=self._key))
        seconds = {"compilation": ready - start, "estimation": time.perf_counter() - ready}
        if self._options.video and result.problems() and self._widened(views, name):
            result, model, more = self(light_field, name)
            seconds = {key: seconds[key] + more[key] for key in seconds}
        return result, model, {key: round(value, 3) for key, value in seconds.items()}

    def _compiled(self, views: LightField) -> tuple[Any, EdgeDepth]:
        if self._program is None:
            with stage(f"compiling for views {'x'.join(map(str, self._kind.shape[:4]))}"):
                asked = self._options
                model = asked.model.model(_over(views, self._ends), all_views=asked.all_views)
                self._program = compiled(estimate_depth, views, model, key=self._key), model
        return self._program

    def _widened(self, views: LightField, name: str) -> bool:
        """Whether a frame has disparities beyond the range of the previous frames."""
        with stage(f"measuring the range of {name}"):
            low, high = scene_range(views)
        before = self._ends
        self._ends = min(low, before[0]), max(high, before[1])
        if self._ends == before:
            return False
        self._program = None
        return True


def _over(light_field: LightField, ends: tuple[float, float]) -> LightField:
    return LightField(
        light_field.views,
        available=light_field.available,
        positions=light_field.positions,
        disparity_range=ends,
    )


def _anonymous(light_field: LightField) -> LightField:
    """Views alone, because names, cameras and ranges would compile another program."""
    return light_field.bare()


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


def _row(report: Path, state: str) -> dict[str, Any]:
    """The row of a finished light field in the summary."""
    try:
        content = read_json(report)
        scores = content["scores"].get("crop 0", {})
        return {
            "state": state,
            "seconds": content["seconds"]["estimation"],
            "compilation": content["seconds"]["compilation"],
            "converged": content["converged"],
            "warnings": content.get("warnings", []),
            **{name: scores.get(name) for name in _SCORES},
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {"state": state, "reason": f"{report} is not readable"}


def _summary(rows: dict[str, dict[str, Any]], out: Path) -> int:
    first = ("name", "state", "seconds", "compilation", "converged")
    columns = [*first, *_SCORES, "warnings", "reason"]
    with (out / "summary.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=columns)
        writer.writeheader()
        for name, row in rows.items():
            row = {"name": name, **row, "warnings": " ".join(row.get("warnings", []))}
            writer.writerow(row)
    write_json(out / "summary.json", rows)
    failed = {name: row for name, row in rows.items() if row["state"] == "failed"}
    for name, row in rows.items():
        for doubt in row.get("warnings", []):
            warn(f"{name}: {doubt}")
    for name, row in failed.items():
        warn(f"{name} failed: {row['reason']}")
    note(f"{len(rows) - len(failed)} of {len(rows)} light fields done; summary.csv in {out}")
    return 1 if failed else 0
