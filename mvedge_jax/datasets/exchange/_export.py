"""Photographs, cameras, points and depth in the formats of other tools."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from mvedge_jax.posed import Photographs

from .._images import IMAGE_SUFFIXES
from ._ply import from_origin, write_ply

# COLMAP and nerfstudio have pixel centers at .5.
_HALF = 0.5
# OpenGL's camera looks along -z with y up, ours along z with y down.
_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
# Units per unit of stored depth: nerfstudio's own, which it does not read from the file.
_UNIT = 1e-3


def write_colmap(folder: str | os.PathLike, photographs: Photographs) -> None:
    """Writes photographs, cameras and sparse points as a COLMAP model.

    Args:
        folder: gets `images/` and `sparse/0/` with `cameras.txt`, `images.txt` and
            `points3D.txt`. Cameras are PINHOLE; a light field's sensor shift is its principal
            point. Points come with the photographs that observed them, and the error -1, which
            is COLMAP's own where it is not known. `photographs.origin` is added to all places.
        photographs: see `Photographs`. Names without the ending of an image get `.png`.

    Raises:
        ValueError: names lead out of the folder, or name one file twice; nothing is written then.
    """
    folder = Path(folder)
    files = _files(folder / "images", photographs)
    model = folder / "sparse" / "0"
    model.mkdir(parents=True, exist_ok=True)
    _write_images(folder / "images", files, photographs)
    poses, points = _in_the_world(photographs)
    matrices = np.asarray(photographs.intrinsics, np.float64)
    height, width = photographs.images.shape[1:3]
    observed = np.zeros((len(poses), len(points)), bool)
    if photographs.observed is not None:
        observed = np.asarray(photographs.observed)
    cameras, images = ["# CAMERA_ID MODEL WIDTH HEIGHT fx fy cx cy"], []
    tracks: list[list[str]] = [[] for _ in points]
    colors = _looked_up(photographs, observed)
    for i, (name, pose, matrix) in enumerate(zip(files, poses, matrices, strict=True), start=1):
        fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2] + _HALF, matrix[1, 2] + _HALF
        cameras.append(f"{i} PINHOLE {width} {height} {fx:.17g} {fy:.17g} {cx:.17g} {cy:.17g}")
        inverse = np.linalg.inv(pose)
        # SciPy has the real part last, COLMAP first.
        turn = np.roll(Rotation.from_matrix(inverse[:3, :3]).as_quat(canonical=True), 1)
        numbers = " ".join(f"{v:.17g}" for v in (*turn, *inverse[:3, 3]))
        images.append(f"{i} {numbers} {i} {name}")
        seen = np.flatnonzero(observed[i - 1])
        places = _projected(points[seen], pose, matrix) + _HALF
        words = []
        for feature, (k, (x, y)) in enumerate(zip(seen, places, strict=True)):
            words.append(f"{x:.6f} {y:.6f} {k + 1}")
            tracks[k].append(f"{i} {feature}")
        images.append(" ".join(words))
    rows = [
        f"{k + 1} {' '.join(f'{v:.17g}' for v in point)} {' '.join(map(str, colors[k]))} "
        f"-1 {' '.join(tracks[k])}"
        for k, point in enumerate(points)
    ]
    (model / "cameras.txt").write_text("\n".join(cameras) + "\n", encoding="utf-8")
    head = "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME / X Y POINT3D_ID ..."
    (model / "images.txt").write_text("\n".join([head, *images]) + "\n", encoding="utf-8")
    head = "# POINT3D_ID X Y Z R G B ERROR IMAGE_ID POINT2D_IDX ..."
    (model / "points3D.txt").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def write_nerfstudio(
    folder: str | os.PathLike,
    photographs: Photographs,
    *,
    depth: Mapping[int, Float[np.ndarray, "y x"]] | None = None,
) -> None:
    """Writes photographs and cameras as nerfstudio's `transforms.json`.

    Args:
        folder: gets `images/`, `transforms.json` and, where depth is given, `depths/` (float32
            `.npy` in thousandths of the unit, which is what nerfstudio expects by default; 0 where
            unknown) and `masks/` (where depth is known). Sparse points become `sparse_pc.ply`.
            `photographs.origin` is added to all places.
        photographs: see `Photographs`. Names without the ending of an image get `.png`.
        depth: of some photographs by their index; not finite or 0 where unknown. nerfstudio wants
            all frames to have depth or none: the masks and depths of the others are all 0.

    Raises:
        ValueError: names lead out of the folder, or name one file twice; nothing is written then.
    """
    folder = Path(folder)
    files = _files(folder / "images", photographs)
    folder.mkdir(parents=True, exist_ok=True)
    _write_images(folder / "images", files, photographs)
    height, width = photographs.images.shape[1:3]
    maps = {
        i: np.where(np.isfinite(values) & (values > 0), values, 0.0)
        for i, values in (depth or {}).items()
    }
    poses, points = _in_the_world(photographs)
    matrices = np.asarray(photographs.intrinsics, np.float64)
    frames = []
    for i, (name, pose, matrix) in enumerate(zip(files, poses, matrices, strict=True)):
        frame = {
            "file_path": f"images/{name}",
            "fl_x": float(matrix[0, 0]),
            "fl_y": float(matrix[1, 1]),
            "cx": float(matrix[0, 2]) + _HALF,
            "cy": float(matrix[1, 2]) + _HALF,
            "w": width,
            "h": height,
            "transform_matrix": (pose @ _TURN).tolist(),
        }
        if maps:
            values = (maps.get(i, np.zeros((height, width))) / _UNIT).astype(np.float32)
            # With the image's own ending before it: names may differ in nothing else.
            stored, mask = f"depths/{name}.npy", f"masks/{name}.png"
            (folder / stored).parent.mkdir(parents=True, exist_ok=True)
            np.save(folder / stored, values)
            _image(folder / mask, np.where(values > 0, 255, 0).astype(np.uint8))
            frame |= {"depth_file_path": stored, "mask_path": mask}
        frames.append(frame)
    top: dict = {"camera_model": "OPENCV", "frames": frames}
    if maps:
        top["depth_unit_scale_factor"] = _UNIT
    if len(points):
        observed = photographs.observed
        seen = np.zeros((len(frames), len(points)), bool) if observed is None else observed
        colors = _looked_up(photographs, np.asarray(seen))
        write_ply(folder / "sparse_pc.ply", points, colors=colors)
        top["ply_file_path"] = "sparse_pc.ply"
    (folder / "transforms.json").write_text(json.dumps(top, indent=1), encoding="utf-8")


def _projected(points: np.ndarray, pose: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    place = ((points - pose[:3, 3]) @ pose[:3, :3]) @ matrix.T
    return place[:, :2] / place[:, 2:]


def _in_the_world(photographs: Photographs) -> tuple[np.ndarray, np.ndarray]:
    """Poses and sparse points in the coordinates of the files that they came from, float64."""
    poses, points = np.array(photographs.poses, np.float64), np.zeros((0, 3))
    # Rotations that are exact only to float32 would move cameras far from the origin.
    left, _, right = np.linalg.svd(poses[:, :3, :3])
    poses[:, :3, :3] = left @ right
    poses[:, :3, 3] += photographs.origin
    if photographs.points is not None:
        points = from_origin(np.asarray(photographs.points), photographs.origin)
    return poses, points


def _looked_up(photographs: Photographs, observed: np.ndarray) -> np.ndarray:
    """Colors of the points in the first photograph that observed them."""
    points = np.zeros((0, 3)) if photographs.points is None else np.asarray(photographs.points)
    colors = np.full((len(points), 3), 128, np.uint8)
    height, width = photographs.images.shape[1:3]
    first = np.where(observed.any(0), observed.argmax(0), -1)
    for i in np.unique(first[first >= 0]):
        new = first == i
        place = _projected(
            points[new], np.asarray(photographs.poses[i]), np.asarray(photographs.intrinsics[i])
        )
        column = np.clip(np.round(place[:, 0]).astype(int), 0, width - 1)
        row = np.clip(np.round(place[:, 1]).astype(int), 0, height - 1)
        colors[new] = _bytes(np.asarray(photographs.images[i]))[row, column]
    return colors


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)


def _files(folder: Path, photographs: Photographs) -> list[str]:
    """File names of the photographs' images; checked before anything is written."""
    files = [
        name if Path(name).suffix.lower() in IMAGE_SUFFIXES else f"{name}.png"
        for name in photographs.names
    ]
    for name, file in zip(photographs.names, files, strict=True):
        # Names come from untrusted files.
        if not (folder / file).resolve().is_relative_to(folder.resolve()):
            raise ValueError(f"`photographs` have the name {name!r}, which leads out of {folder}.")
        if files.count(file) > 1:
            raise ValueError(f"`photographs` have the name {name!r} besides {file!r}; rename one.")
    return files


def _write_images(folder: Path, files: list[str], photographs: Photographs) -> None:
    for name, image in zip(files, np.asarray(photographs.images), strict=True):
        _image(folder / name, np.ascontiguousarray(_bytes(image)[..., ::-1]))


def _image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path} could not be written.")
