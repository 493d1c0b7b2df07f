"""`mvedge batch`: depth of many light fields."""

import csv
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import tyro

from mvedge_jax.centre import Parameters, Sizes, edge_to_depth
from mvedge_jax.datasets import load_light_field
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField

from ._common import compiled, missing_views, note, stage, warn
from ._depth import depth_report, score_depth, write_depth
from ._output import MARKER, output_folder, write_json
from ._paths import scenes_and_out

_SCORES = ("mse", "q25", "bad_01", "bad_03", "bad_07")


class _Kind(NamedTuple):
    """Light fields that share a program: shape and precision of their views."""

    shape: tuple[int, ...]
    dtype: str


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
    again: bool = False,
) -> int:
    """Estimates depth of many light fields, one after the other.

    OUT gets a folder for each light field, with what `mvedge depth` writes, and summary.csv and
    summary.json over all. Light fields of one shape are computed by one program, over the disparity
    range of all of them; `mvedge depth` would choose each range for itself. What OUT holds already
    is not computed again; a light field that fails is reported at the end and stops no other.

    Args:
        paths: light fields, then the folder for the results.
        views: use the central VIEWS x VIEWS views only; odd.
        scale: shrink the views by this factor, at most 1.
        range: lowest and highest disparity of all, px per view step; otherwise each is measured if
            not known.
        all_views: measure disparity in all views at the end.
        again: compute again what is there already.

    Returns:
        The exit code: 0, or 1 if a light field failed.
    """
    scenes, out = scenes_and_out(paths)
    names = _names(scenes)
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"{out} is a file, expected a folder to write into.")
    out.mkdir(parents=True, exist_ok=True)
    rows: dict[str, dict[str, Any]] = {}
    kinds: dict[_Kind, list[tuple[str, Path]]] = {}
    ranges: dict[_Kind, tuple[float, float]] = {}
    for name, scene in zip(names, scenes, strict=True):
        if not again and (out / name / MARKER).exists():
            rows[name] = _row(out / name / "report.json", "there already")
            continue
        try:
            with stage(f"reading {scene}"):
                found = load_light_field(scene, views=views, scale=scale).without_truth()
                ends = scene_range(found) if range is None else range
        except (ValueError, OSError, MemoryError) as reason:
            rows[name] = {"state": "failed", "reason": str(reason)}
            continue
        kind = _Kind(found.views.shape, str(found.views.dtype))
        low, high = ranges.get(kind, ends)
        ranges[kind] = min(low, ends[0]), max(high, ends[1])
        kinds.setdefault(kind, []).append((name, scene))
    for kind, members in kinds.items():
        _run(members, kind, ranges[kind], rows, out, (views, scale, all_views))
        # A program holds some 2400 memory maps, of which Linux allows 65530.
        jax.clear_caches()
    return _summary({name: rows[name] for name in names}, out)


def _run(
    members: Sequence[tuple[str, Path]],
    kind: _Kind,
    ends: tuple[float, float],
    rows: dict[str, dict[str, Any]],
    out: Path,
    options: tuple[int | None, float, bool],
) -> None:
    """Light fields of one shape, through one program."""
    views, scale, every = options
    params, program = Parameters(), None
    for name, scene in members:
        try:
            with stage(f"reading {scene}"):
                found = _over(load_light_field(scene, views=views, scale=scale), ends)
            blind, start = found.without_truth(), time.perf_counter()
            if program is None:
                with stage(f"compiling for views {'x'.join(map(str, kind.shape[:4]))}"):
                    sizes = Sizes.for_light_field(blind, views="all" if every else "crosshair")
                    program = compiled(edge_to_depth, _anonymous(blind), params, sizes), sizes
            estimate, sizes = program
            ready = time.perf_counter()
            with stage(f"estimating depth of {name}"):
                result = jax.block_until_ready(estimate(_anonymous(blind), params, sizes))
            seconds = {
                "compilation": round(ready - start, 3),
                "estimation": round(time.perf_counter() - ready, 3),
            }
            # What is there is an earlier result of ours, or the folder refuses.
            with output_folder(out / name, inputs=[scene], overwrite=True) as folder:
                report = depth_report(found, params, sizes, result, seconds)
                write_depth(folder, found, result)
                report["scores"] = score_depth(folder, found, result)
                report["warnings"] = [*result.problems(), *(missing_views(found) if every else [])]
                write_json(folder / "report.json", report)
            rows[name] = _row(out / name / "report.json", "done")
        except (ValueError, OSError, MemoryError) as reason:
            rows[name] = {"state": "failed", "reason": str(reason)}


def _over(light_field: LightField, ends: tuple[float, float]) -> LightField:
    return LightField(
        light_field.views,
        available=light_field.available,
        disparity_range=ends,
        truth=light_field.truth,
        camera=light_field.camera,
        name=light_field.name,
    )


def _anonymous(light_field: LightField) -> LightField:
    """Views alone: names, cameras and ranges would make a program of their own."""
    return LightField(light_field.views, available=light_field.available)


def _names(scenes: Sequence[Path]) -> list[str]:
    """Folders of the results: the scenes' names, with as many parents as tell them apart."""
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
    """What the summary says of a finished light field."""
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
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
