"""`mvedge depth`: a dense disparity map of the center view."""

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import cv2
import jax
import numpy as np
import tyro

from mvedge_jax import plotting, viewer
from mvedge_jax._stored_views import StoredViews
from mvedge_jax.datasets import write_pfm
from mvedge_jax.depth import DepthResult, DepthStats, EdgeDepth, estimate_depth
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.metrics import boundary_scores, calibration, depth_scores

from ._common import missing_views, note, positions_of, run, score_line, stage, warn
from ._model import FULL, ModelArg
from ._output import output_folder, write_json
from ._points import valid_points, write_points
from ._source import read_scene, source_of
from ._tiles import estimate_tiles, in_tiles, read_stored
from ._view import show


def depth(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    views: int | None = None,
    scale: float = 1.0,
    flip_u: bool = False,
    flip_v: bool = False,
    swap_axes: bool = False,
    positions: Path | None = None,
    range: tuple[float, float] | None = None,
    all_views: bool = False,
    tile: int | None = None,
    memory: float | None = None,
    view: bool = False,
    overwrite: bool = False,
    options: ModelArg = FULL,
    seed: int = 0,
) -> None:
    """Estimates the disparity of every pixel of a light field's center view.

    OUT gets disparity.pfm, disparity16.png (range in report.json), disparity.png in color, its
    standard error as standard_error.pfm and .png, points.npz, points.csv, report.json and,
    if the camera is known, depth.pfm in meters. With ground truth: error maps and scores, over
    the whole frame and without 15 px per side.

    `--preset edges` is the depth of the edges alone, `--preset thesis` that of the dissertation.
    `--set smoothness.color=.3 --set refine.solves=1` sets numbers and static fields of the model by
    their paths; report.json lists all of them with their values.

    Args:
        scene: folder or file of a light field; `mvedge info` checks it.
        out: folder to write.
        views: use the central VIEWS x VIEWS views only; odd.
        scale: shrink the views by this factor, at most 1.
        flip_u: reverse the columns of views.
        flip_v: reverse the rows of views.
        swap_axes: exchange rows and columns of views, before they are reversed.
        positions: text file with a line `v u x y` per view: row, column, position in view steps.
        range: lowest and highest disparity, px per view step; measured if unknown.
        all_views: measure disparity in all views at the end, not in the central row and column
            alone: more accurate, twice as slow.
        tile: estimate the depth of an image too large for the memory in tiles of TILE x TILE px,
            which overlap by 96.
        memory: likewise, in tiles as large as MEMORY gigabytes allow.
        view: show the result in a browser until Ctrl-C, as `mvedge view` does.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        options: options of the model.
        seed: seed of the random search of preset thesis.
    """
    options.check(all_views=all_views)
    tiled = in_tiles(tile, memory, all_views=all_views, scale=scale, view=view)
    order: dict[str, Any] = {"flip_u": flip_u, "flip_v": flip_v, "swap_axes": swap_axes}
    order["positions"] = None if positions is None else str(positions.resolve())
    key = jax.random.key(seed)
    with stage(f"reading {scene}"):
        if tiled:
            light_field, truth, said = read_stored(scene, views=views, range=range, **order)
        else:
            light_field, said = read_scene(scene, views=views, scale=scale, **order)
            truth = light_field.truth
            if range is not None:
                light_field = light_field.with_range(*range)
    with output_folder(out, inputs=[scene], overwrite=overwrite) as folder:
        if isinstance(light_field, StoredViews):
            model, result, seconds = estimate_tiles(light_field, tile, memory, options, key=key)
        else:
            blind = light_field.without_truth()
            with stage("choosing sizes"):
                model = options.model(blind, all_views=all_views)
            doing = "estimating depth"
            result, seconds = run("depth", doing, estimate_depth, blind, model, key=key)
        with stage("writing"):
            told = options.described(model) | {"seed": seed, "seconds": seconds, "warnings": said}
            told["source"] = source_of(scene, views=views, scale=scale, **order)
            report = write_depth(folder, light_field, truth, model, result, told)
    for doubt in report["warnings"]:
        warn(doubt)
    for crop, row in report["scores"].items():
        note(score_line(crop, row))
    found, spent = int(result.stats.edges.valid), seconds["estimation"]
    note(f"{found} edge points, {spent:.1f} s; written to {out}")
    if view and isinstance(light_field, LightField):
        show(light_field, [viewer.result_of(result, name=out.name)])


def write_depth(
    folder: Path,
    light_field: LightField | StoredViews,
    truth: GroundTruth | None,
    model: EdgeDepth,
    result: DepthResult,
    told: dict[str, Any],
) -> dict[str, Any]:
    """Writes all files of a map; the report, with what is `told`, of which warnings come first."""
    disparity = np.asarray(result.disparity)
    write_pfm(folder / "disparity.pfm", disparity)
    low, high = float(disparity.min()), float(disparity.max())
    levels = np.round((disparity - low) / max(high - low, 1e-12) * 65535).astype(np.uint16)
    (folder / "disparity16.png").write_bytes(cv2.imencode(".png", levels)[1].tobytes())
    error = np.asarray(result.error)
    write_pfm(folder / "standard_error.pfm", error)
    label = "standard error (px per view step)"
    figure = plotting.plot_error(error, np.zeros_like(error), label=label)
    figure.savefig(folder / "standard_error.png")
    plotting.plot_disparity(disparity).savefig(folder / "disparity.png")
    if light_field.camera is not None:
        write_pfm(folder / "depth.pfm", np.asarray(light_field.camera.depth(result.disparity)))
    surface = np.asarray(result.surface.offset)[np.asarray(result.points.valid)]
    write_points(folder, valid_points(result.points), surface=surface)
    every = model.measurement is not None and model.measurement.views == "all"
    doubts = [*told["warnings"], *result.problems(), *(missing_views(light_field) if every else [])]
    report = _report(light_field, result) | told | {"warnings": doubts}
    report["scores"] = {} if truth is None else _score(folder, truth, result)
    write_json(folder / "report.json", report)
    return report


def _score(folder: Path, truth: GroundTruth, result: DepthResult) -> dict[str, Any]:
    """Scores by crop; writes error maps."""
    known = np.where(np.asarray(truth.valid), np.asarray(truth.disparity), np.nan)
    for kind in ("log", "signed"):
        figure = plotting.plot_error(np.asarray(result.disparity), known, kind=kind)
        figure.savefig(folder / f"error_{kind}.png")
    scores = {}
    for crop in (0, 15):
        if 2 * crop >= min(known.shape):
            continue
        maps, pixels = (result.disparity, truth.disparity), {"mask": truth.valid, "crop": crop}
        boundary = boundary_scores(*maps, **pixels)
        stated = calibration(result.disparity, result.error, truth.disparity, **pixels)
        scores[f"crop {crop}"] = {
            **{name: float(v) for name, v in depth_scores(*maps, **pixels)._asdict().items()},
            "boundary_peak_f1": float(boundary.peak_f1),
            "boundary_auc": float(boundary.auc),
            "within_two_errors": float(stated.within[1]),
            "ause": float(stated.ause),
        }
    return scores


def _photometry(stats: DepthStats) -> dict[str, Any]:
    """Exposure and gains removed from the views, and the remaining noise."""
    gain, uneven = np.asarray(stats.exposure.gain), np.asarray(stats.exposure.unevenness)
    row, column = (count // 2 for count in gain.shape)
    return {
        "noise of 255": 255 * float(stats.noise.deviation),
        "share that noise rules": float(stats.noise.alpha),
        "brightened by": float(stats.exposure.scale),
        "gain of the center row of views": gain[row].tolist(),
        "gain of the center column of views": gain[:, column].tolist(),
        "vignette of the center row of views": uneven[row].tolist(),
        "vignette of the center column of views": uneven[:, column].tolist(),
    }


def _report(light_field: LightField | StoredViews, result: DepthResult) -> dict[str, Any]:
    """Statistics of a map."""
    stored = isinstance(light_field, StoredViews)
    disparity = np.asarray(result.disparity)
    stats = result.stats
    # Infinite without any label.
    known = bool(np.isfinite(result.error).all())
    spread = np.quantile(result.error, (0.5, 0.95)).tolist() if known else None
    return {
        "scene": light_field.name,
        "shape [v, u, y, x]": list(light_field.shape if stored else light_field.views.shape[:4]),
        "positions": positions_of(light_field),
        "disparity range": [float(disparity.min()), float(disparity.max())],
        "standard error, median and 95 %": spread,
        "photometry": _photometry(stats),
        "counts": {
            **{name: int(value) for name, value in vars(stats.edges).items()},
            "labeled pixels": int(stats.points),
            "surface vectors": int(stats.sided),
        },
        "diffusion iterations": np.asarray(stats.iterations).tolist(),
        "converged": bool(stats.converged),
        "versions": {name: version(name) for name in ("jax", "jaxlib", "equinox", "numpy")},
        "device": jax.devices()[0].device_kind,
        "machine": platform.platform(),
    }
