"""What there is to export: photographs with cameras, and the depth that an earlier run found."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import h5py
import numpy as np
from jaxtyping import Float

from mvedge_jax.datasets import load_light_field, read_pfm
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.lightfield import Camera, LightField
from mvedge_jax.posed import Photographs
from mvedge_jax.posed.cloud import photographs_of


class Gathered(NamedTuple):
    """Photographs, and depth of some of them by their index.

    Attributes:
        photographs: with their cameras; sparse points where they are known.
        depth: in the unit of the poses.
        error: standard errors of the depths.
        point_error: standard errors of the sparse points along their lines of sight, if known.
    """

    photographs: Photographs
    depth: dict[int, Float[np.ndarray, "y x"]]
    error: dict[int, Float[np.ndarray, "y x"]]
    point_error: Float[np.ndarray, " m"] | None = None


def gather(path: Path, camera: tuple[float, float, float] | None) -> Gathered:
    """Reads a light field, or what `mvedge depth`, `views` or `stereo` wrote.

    Args:
        path: a scene, a model, or a result.
        camera: focal length, px, baseline and focus distance of a light field that does not know
            its own.

    Returns:
        What there is.

    Raises:
        FileNotFoundError: `path`, or the scene that a result was made from, is not there.
        ValueError: a result does not say what it was made from, or the camera is not known.
    """
    report = _report(path)
    if report is None:
        field = _with_camera(load_light_field(path), camera, path)
        return Gathered(photographs_of(field), {}, {})
    if "model" in report:
        return _of_stereo(path, report)
    source = report.get("source")
    if not isinstance(source, dict):
        raise ValueError(
            f"{path / 'report.json'} does not say which light field it was made from; make the "
            "result again with this version of mvedge, or export the scene itself."
        )
    field = _with_camera(_again(path, source), camera, Path(source["path"]))
    assert field.camera is not None
    if (path / "views.h5").is_file():
        return _of_views(path, field, field.camera)
    return _of_depth(path, field, field.camera)


def _report(path: Path) -> dict[str, Any] | None:
    """The report of a result of ours; None for anything else."""
    file = path / "report.json"
    if not (path / ".mvedge.json").is_file() or not file.is_file():
        return None
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        report = None
    if not isinstance(report, dict):
        raise ValueError(f"{file} is no report of mvedge.")
    return report


def _again(path: Path, source: dict[str, Any]) -> LightField:
    options = {key: value for key, value in source.items() if key != "path"}
    if not Path(source["path"]).exists():
        raise FileNotFoundError(f"{source['path']}, which {path} was made from, does not exist.")
    return load_light_field(source["path"], **options)


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
    if not (focal > 0 and baseline > 0 and focus > 0):
        raise ValueError(f"--camera must be three positive numbers, got {camera}.")
    return eqx.tree_at(
        lambda field: field.camera,
        light_field,
        Camera(focal, baseline, focus),
        is_leaf=lambda leaf: leaf is None,
    )


def _of_depth(path: Path, field: LightField, camera: Camera) -> Gathered:
    photographs = photographs_of(field)
    vc, uc = field.centre
    index = int(np.asarray(field.available).ravel()[: vc * field.views.shape[1] + uc].sum())
    disparity = read_pfm(path / "disparity.pfm")
    depth, error = _metric(camera, disparity, read_pfm(path / "standard_error.pfm"))
    with np.load(path / "points.npz") as stored:
        xy, of_points = stored["xy"], stored["disparity"]
        visible, spread = stored["visible"], stored["error"]
    z, doubt = _metric(camera, of_points, spread)
    matrix = np.asarray(photographs.intrinsics[index])
    local = np.stack([(xy[:, 0] - matrix[0, 2]) / matrix[0, 0] * z,
                      (xy[:, 1] - matrix[1, 2]) / matrix[1, 1] * z, z], axis=1)  # fmt: skip
    world = local + np.asarray(photographs.centres[index])
    keep = np.isfinite(z)
    observed = _observed(field, visible)
    dense = Photographs(
        photographs.images,
        photographs.poses,
        photographs.intrinsics,
        points=world[keep],
        observed=observed[:, keep],
        depth=photographs.depth,
        names=photographs.names,
        name=photographs.name,
    )
    return Gathered(dense, {index: depth}, {index: error}, doubt[keep])


def _observed(field: LightField, visible: np.ndarray) -> np.ndarray:
    """Which of all available views saw which point: those of the crosshair were looked at."""
    rows, columns = field.views.shape[:2]
    vc, uc = field.centre
    seen = np.zeros((rows, columns, visible.shape[0]), bool)
    seen[:, uc] |= visible[:, :rows].T
    seen[vc] |= visible[:, rows:].T
    return seen[np.asarray(field.available)]


def _of_views(path: Path, field: LightField, camera: Camera) -> Gathered:
    with h5py.File(path / "views.h5", "r") as file:
        disparity, error = np.asarray(file["disparity"]), np.asarray(file["error"])
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
    model = Path(report["model"])
    if not model.exists():
        raise FileNotFoundError(f"{model}, which {path} was made from, does not exist.")
    photographs = load_photographs(
        model, images=report["images"], intrinsics=report["intrinsics"], scale=report["scale"]
    )
    depth, error = {}, {}
    for name in report["photographs"]:
        index = photographs.index(name)
        stem = "_".join(Path(photographs.names[index]).with_suffix("").parts)
        depth[index] = read_pfm(path / f"{stem}_depth.pfm").astype(np.float64)
        error[index] = read_pfm(path / f"{stem}_error.pfm").astype(np.float64)
    return Gathered(photographs, depth, error)
