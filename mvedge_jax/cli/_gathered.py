"""Data to export: photographs with cameras, and the depth of an earlier run."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from mvedge_jax.datasets import columns_of, load_light_field, read_pfm
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.lightfield import Camera, LightField
from mvedge_jax.posed import Photographs
from mvedge_jax.posed.cloud import photographs_of

from ._paths import stems_of
from ._source import read_json, scene_of
from ._view_maps import view_maps


class Gathered(NamedTuple):
    """Photographs, and depth of some of them by their index.

    Attributes:
        photographs: photographs with cameras, and sparse points if known.
        depth: depth in the unit of the poses.
        error: standard errors of the depths, if known.
        point_error: standard errors of the sparse points along their lines of sight, if known.
    """

    photographs: Photographs
    depth: dict[int, Float[np.ndarray, "y x"]]
    error: dict[int, Float[np.ndarray, "y x"]]
    point_error: Float[np.ndarray, " m"] | None = None


def gather(path: Path, camera: tuple[float, float, float] | None) -> Gathered:
    """Reads a light field, or a result of `mvedge depth`, `views` or `stereo`.

    `camera` has focal length, px, baseline and focus distance, for a light field that does not know
    its camera. Errors name the file.
    """
    report = _report(path)
    if report is None:
        field = _with_camera(load_light_field(path), camera, path)
        return Gathered(photographs_of(field), {}, {})
    if "model" in report:
        return _of_stereo(path, report)
    scene, reading = scene_of(path, advice="make the result again, or export the scene itself")
    field = _with_camera(load_light_field(scene, **reading), camera, scene)
    assert field.camera is not None
    if (path / "views.h5").is_file():
        return _of_views(path, field, field.camera)
    return _of_depth(path, field, field.camera)


def _report(path: Path) -> dict[str, Any] | None:
    """The report of a result of mvedge; None for anything else."""
    file = path / "report.json"
    ours = (path / ".mvedge.json").is_file() and file.is_file()
    return read_json(file) if ours else None


def _with_camera(
    light_field: LightField, camera: tuple[float, float, float] | None, path: Path
) -> LightField:
    if camera is None:
        if light_field.camera is None:
            raise ValueError(
                f"{path} does not know its camera; give its focal length in px, baseline and focus "
                "distance (--camera)."
            )
        return light_field
    focal, baseline, focus = camera
    if not (np.isfinite(camera).all() and focal > 0 and baseline > 0 and focus > 0):
        raise ValueError(f"--camera must be three finite numbers above 0, got {camera}.")
    return eqx.tree_at(
        lambda field: field.camera,
        light_field,
        Camera(focal, baseline, focus),
        is_leaf=lambda leaf: leaf is None,
    )


def _of_depth(path: Path, field: LightField, camera: Camera) -> Gathered:
    photographs = photographs_of(field)
    vc, uc = field.center
    index = int(np.asarray(field.available).ravel()[: vc * field.views.shape[1] + uc].sum())
    shape = field.views.shape[2:4]
    depth, error = _metric(
        camera, *(_map(path / f"{name}.pfm", shape) for name in ("disparity", "standard_error"))
    )
    xy, of_points, spread, visible = _points(path / "points.npz", sum(field.views.shape[:2]))
    z, doubt = _metric(camera, of_points, spread)
    matrix = np.asarray(photographs.intrinsics[index])
    local = np.stack([(xy[:, 0] - matrix[0, 2]) / matrix[0, 0] * z,
                      (xy[:, 1] - matrix[1, 2]) / matrix[1, 1] * z, z], axis=1)  # fmt: skip
    world = local + np.asarray(photographs.centers[index])
    keep = np.isfinite(z)
    observed = _observed(field, visible)
    # The constructor refuses places that are not finite.
    dense = dataclasses.replace(photographs, points=world[keep], observed=observed[:, keep])
    return Gathered(dense, {index: depth}, {index: error}, doubt[keep])


def _map(path: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "y x"]:
    """A map of the size of the views."""
    found = read_pfm(path)
    if found.shape != shape:
        raise ValueError(f"{path} must have the size of the views, {shape}, got {found.shape}.")
    return found


def _points(path: Path, views: int) -> list[np.ndarray]:
    """Place, disparity, its standard error, and which view of the crosshair shows a point."""
    with columns_of(path) as stored:
        columns = [stored[name] for name in ("xy", "disparity", "error", "visible")]
        count = len(columns[1])
        wanted = [(count, 2), (count,), (count,), (count, views)]
        if [column.shape for column in columns] != wanted:
            raise ValueError("its columns do not fit together or to the views")
        if not all(column.dtype.kind in "fiub" for column in columns):
            raise ValueError("its columns are not numbers")
    return [*columns[:3], columns[3].astype(bool)]


def _observed(field: LightField, visible: np.ndarray) -> np.ndarray:
    """Available views that show each point; only those of the crosshair were tested."""
    rows, columns = field.views.shape[:2]
    vc, uc = field.center
    seen = np.zeros((rows, columns, visible.shape[0]), bool)
    seen[:, uc] |= visible[:, :rows].T
    seen[vc] |= visible[:, rows:].T
    return seen[np.asarray(field.available)]


def _of_views(path: Path, field: LightField, camera: Camera) -> Gathered:
    disparity, error = view_maps(path / "views.h5", field.views.shape[:4], "disparity", "error")
    there = np.asarray(field.available)
    pairs = [_metric(camera, *pair) for pair in zip(disparity[there], error[there], strict=True)]
    return Gathered(
        photographs_of(field),
        {i: depth for i, (depth, _) in enumerate(pairs)},
        {i: error for i, (_, error) in enumerate(pairs)},
    )


def _metric(
    camera: Camera, disparity: np.ndarray, error: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and its standard error from those of a disparity."""
    scale = float(camera.focal_px) * float(camera.baseline)
    inverse = disparity.astype(np.float64) / scale + 1 / float(camera.focus_distance)
    depth = np.where(inverse > 0, 1 / np.where(inverse > 0, inverse, 1), np.inf)
    return depth, np.where(np.isfinite(depth), depth, 0) ** 2 * error / scale


def _of_stereo(path: Path, report: dict[str, Any]) -> Gathered:
    model, images, lens = report["model"], report.get("images"), report.get("intrinsics")
    told = isinstance(model, str) and isinstance(images, str | None)
    told = told and isinstance(report.get("scale"), int | float)
    told = told and isinstance(report.get("photographs"), dict)
    if lens is not None:
        told = told and isinstance(lens, list) and len(lens) == 4
        told = told and all(isinstance(value, int | float) for value in lens)
    if not told:
        file = path / "report.json"
        raise ValueError(f"{file} does not tell its photographs; make the result again.")
    if not Path(model).exists():
        raise FileNotFoundError(f"{model}, which {path} was made from, does not exist.")
    photographs = load_photographs(
        Path(model), images=images, intrinsics=lens, scale=report["scale"]
    )
    shape = photographs.images.shape[1:3]
    depth, error, stems = {}, {}, stems_of(photographs.names)
    for name in report["photographs"]:
        index = photographs.index(name)
        stem = stems[photographs.names[index]]
        depth[index] = _map(path / f"{stem}_depth.pfm", shape).astype(np.float64)
        if report.get("method") != "points":
            error[index] = _map(path / f"{stem}_error.pfm", shape).astype(np.float64)
    return Gathered(photographs, depth, error)
