"""`transforms.json` of nerfstudio and instant-ngp: photographs and cameras for radiance fields."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from .._images import IMAGE_SUFFIXES, image_size
from ..exchange._ply import read_ply
from ._posed_source import Frame, Lens, PosedSource, pinhole, rigid

# OpenGL's camera looks along -z with y up, ours along z with y down.
_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
# Pixel centers are at .5, as in COLMAP, the usual source of these files.
_HALF = 0.5
_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
# In a folder, the first of these is read; the second is that of the synthetic scenes of NeRF.
TRANSFORMS = ("transforms.json", "transforms_train.json")


def open_nerfstudio(path: Path) -> PosedSource:
    """Opens a `transforms.json`: its photographs in the order of their names.

    Images are found relative to its folder. Errors name the file, and the frame.
    """
    try:
        top = json.loads(path.read_bytes())  # detects the encoding, byte order marks included
    except (json.JSONDecodeError, UnicodeDecodeError) as fault:
        raise ValueError(f"{path} is not JSON ({fault}); expected nerfstudio's form.") from None
    frames = top.get("frames") if isinstance(top, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise ValueError(f"{path} has no list `frames`; expected nerfstudio's form.")
    if len(frames) < 2:
        raise ValueError(f"{path} lists {len(frames)} frames; expected at least two.")
    found = [_frame(path, i, frame, {**top, **frame}) for i, frame in enumerate(frames)]
    names = [frame.name for frame in found]
    if len(set(names)) < len(names):
        # Folders distinguish equal names.
        found = [
            Frame(str(frame["file_path"]), f.image, f.pose, f.lens, f.depth)
            for frame, f in zip(frames, found, strict=True)
        ]
    points = None
    if isinstance(top.get("ply_file_path"), str):
        points = read_ply(path.parent / top["ply_file_path"])
        points = points if len(points) else None
    ordered = tuple(sorted(found, key=lambda frame: frame.name))
    unit = top.get("depth_unit_scale_factor", 1e-3)
    if isinstance(unit, bool) or not isinstance(unit, int | float) or not 0 < unit < math.inf:
        raise ValueError(
            f"{path} has depth_unit_scale_factor = {unit!r}; expected a positive number."
        )
    return PosedSource("nerfstudio transforms.json", ordered, points, depth_unit=float(unit))


def _frame(path: Path, index: int, own: dict[str, Any], known: dict[str, Any]) -> Frame:
    where = f"{path}, frame {index},"
    if not isinstance(own.get("file_path"), str):
        raise ValueError(f"{where} has no `file_path`; expected the name of an image.")
    image = _image(path.parent / own["file_path"])
    if image is None:
        raise FileNotFoundError(
            f"{path.parent / own['file_path']} is missing; {where} names it as its image."
        )
    try:
        matrix = np.asarray(own["transform_matrix"], np.float64)
    except (KeyError, TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])
    if matrix.shape != (4, 4):
        raise ValueError(f"{where} has no `transform_matrix` of 4x4 numbers.")
    pose = rigid(matrix, where=where) @ _TURN
    depth = own.get("depth_file_path")
    depth_file = path.parent / depth if isinstance(depth, str) else None
    if depth_file is not None and not depth_file.is_file():
        raise FileNotFoundError(f"{depth_file} is missing; {where} names it as its depth.")
    return Frame(image.name, image, pose, _lens(known, where, image), depth_file)


def _image(named: Path) -> Path | None:
    """The image of a name, which may lack its ending, or have it in the other case."""
    if named.is_file():
        return named
    for end in IMAGE_SUFFIXES:
        for file in (Path(f"{named}{end}"), Path(f"{named}{end.upper()}")):
            if file.is_file():
                return file
    if not named.parent.is_dir():
        return None
    wanted = {f"{named.name.lower()}{end}" for end in ("", *IMAGE_SUFFIXES)}
    files = (file for file in named.parent.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    return next((f for f in sorted(files) if f.name.lower() in wanted and f.is_file()), None)


def _lens(known: dict[str, Any], where: str, image: Path) -> Lens:
    def number(name: str) -> float | None:
        value = known.get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{where} has {name} = {value!r}; expected a number.")
        return float(value)

    model = known.get("camera_model", "OPENCV")
    # instant-ngp's own scripts write the second form.
    fisheye = model == "OPENCV_FISHEYE" or known.get("is_fisheye") is True
    if not fisheye and model not in _PERSPECTIVE:
        raise ValueError(
            f"{where} has the camera model {model!r}, which is not handled; expected one of "
            f"{', '.join((*_PERSPECTIVE, 'OPENCV_FISHEYE'))}."
        )
    width, height = number("w"), number("h")
    fx, fy, cx, cy = (number(name) for name in ("fl_x", "fl_y", "cx", "cy"))
    if (width is None or height is None) and None in (fx, cx, cy):
        rows, columns = map(float, image_size(image))
        width, height = columns if width is None else width, rows if height is None else height
    size = None if width is None or height is None else (int(height), int(width))

    def of_angle(name: str, side: float | None) -> float | None:
        angle = number(name)
        if angle is None or side is None:
            return None
        if not 0 < angle < math.pi:
            raise ValueError(f"{where} has {name} = {angle:g}; expected radians from 0 to pi.")
        return 0.5 * side / math.tan(0.5 * angle)

    if fx is None:
        fx = of_angle("camera_angle_x", width)
        fy = of_angle("camera_angle_y", height) if fy is None else fy
    if fx is None:
        raise ValueError(
            f"{where} has no intrinsics; expected fl_x (and fl_y, cx, cy), or camera_angle_x."
        )
    cx = 0.5 * (width or 0) if cx is None else cx
    cy = 0.5 * (height or 0) if cy is None else cy
    matrix = pinhole(fx, fx if fy is None else fy, cx - _HALF, cy - _HALF, where=where, size=size)
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    bent = tuple(number(name) or 0.0 for name in names)
    return Lens(size, matrix, bent if any(bent) or fisheye else None, fisheye)
