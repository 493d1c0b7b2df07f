"""Photographs beside a list of poses: Redwood's logs, and the TUM benchmark's."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from .._images import IMAGE_SUFFIXES
from ._posed_source import Frame, Lens, PosedSource, pinhole, rigid, rotation_of

# Names of a folder's list of poses, in order of search.
_LISTS = ("trajectory.log", "traj.log", "trajectory.txt", "groundtruth.txt", "poses.txt")
_CAMERAS = ("camera.json", "intrinsics.json", "camera_primesense.json", "camera.txt")
# Largest difference of the times of an image and its pose, seconds.
_APART = 0.02


def find_trajectory(folder: Path) -> Path | None:
    """The list of poses of a folder; None if there is none."""
    named = [folder / name for name in _LISTS]
    return next((path for path in named if path.is_file()), None)


def open_trajectory(
    path: Path, images: Path | None, intrinsics: Sequence[float] | None
) -> PosedSource:
    """Opens a list of poses and the photographs beside it, or in `images`, ordered by name.

    Redwood's form gives each pose as a line of numbers and a 4x4 matrix, in the order of the
    images' names. TUM's gives `time x y z qx qy qz qw` in a line; `rgb.txt` or the images' names
    say their times. Beside an image `NAME.jpg`, `depth_NAME.png` is its true depth. `intrinsics`
    `(fx, fy, cx, cy)` are px, centers of pixels at integers; None reads them from a camera file.
    """
    folder = path.parent if images is None else images
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    rows = [(i, line.split()) for i, line in enumerate(lines, 1) if line.strip()]
    rows = [(i, words) for i, words in rows if not words[0].startswith("#")]
    if rows and len(rows[0][1]) == 8:
        pairs, layout = _timed(path, folder, rows), "TUM trajectory"
    else:
        pairs, layout = _listed(path, folder, rows), "Redwood trajectory"
    lens = Lens(None, _intrinsics(path.parent, intrinsics))
    frames = []
    for image, pose in pairs:
        depth = image.with_name(f"depth_{image.stem}.png")
        frames.append(Frame(image.name, image, pose, lens, depth if depth.is_file() else None))
    return PosedSource(layout, tuple(sorted(frames, key=lambda frame: frame.name)))


def _numbers(path: Path, line: int, words: list[str], count: int) -> np.ndarray:
    try:
        values = np.asarray([float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count:
        raise ValueError(
            f"{path}, line {line}: {' '.join(words)[:60]!r}; expected {count} numbers."
        )
    return values


def _photographs(folder: Path) -> list[Path]:
    """In the order of their numbers, whether or not these are filled up with zeros."""
    files = (
        file
        for file in folder.iterdir()
        if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith("depth_")
    )

    def order(file: Path) -> list[tuple[int, str]]:
        parts = re.split(r"(\d+)", file.name)
        return [(int(part), "") if part.isdigit() else (0, part) for part in parts]

    return sorted(files, key=order)


def _listed(
    path: Path, folder: Path, rows: list[tuple[int, list[str]]]
) -> list[tuple[Path, Float[np.ndarray, "4 4"]]]:
    if len(rows) % 5:
        raise ValueError(
            f"{path} has {len(rows)} lines, expected 5 per pose: a line of numbers and a 4x4 "
            "matrix; or lines of 8 numbers, `time x y z qx qy qz qw`."
        )
    poses = []
    for start in range(0, len(rows), 5):
        matrix = np.stack([_numbers(path, *rows[start + k], 4) for k in range(1, 5)])
        poses.append(rigid(matrix, where=f"{path}, line {rows[start][0]},"))
    files = _photographs(folder)
    if len(files) != len(poses):
        raise ValueError(
            f"{path} has {len(poses)} poses and {folder} has {len(files)} images; expected as many."
        )
    return list(zip(files, poses, strict=True))


def _timed(
    path: Path, folder: Path, rows: list[tuple[int, list[str]]]
) -> list[tuple[Path, Float[np.ndarray, "4 4"]]]:
    values = np.stack([_numbers(path, line, words, 8) for line, words in rows])
    pairs = []
    for time, image in _times(path, folder):
        nearest = int(np.argmin(np.abs(values[:, 0] - time)))
        if abs(values[nearest, 0] - time) > _APART:
            continue
        where = f"{path}, line {rows[nearest][0]},"
        pose = np.eye(4)
        pose[:3, :3] = rotation_of(values[nearest, [7, 4, 5, 6]], where=where)
        pose[:3, 3] = values[nearest, 1:4]
        pairs.append((image, rigid(pose, where=where)))
    if len(pairs) < 2:
        raise ValueError(
            f"{path} has poses within {_APART} s of {len(pairs)} images in {folder}, expected two "
            "or more; `rgb.txt` or the images' names say their times."
        )
    return pairs


def _times(path: Path, folder: Path) -> list[tuple[float, Path]]:
    listed = path.parent / "rgb.txt"
    if not listed.is_file():
        found = []
        for file in _photographs(folder):
            try:
                found.append((float(file.stem), file))
            except ValueError:
                continue
        return found
    found = []
    for line, text in enumerate(listed.read_text(encoding="utf-8-sig").splitlines(), 1):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 2:
            raise ValueError(f"{listed}, line {line}: {text!r}; expected a time and a file.")
        time = _numbers(listed, line, words[:1], 1)[0]
        found.append((float(time), path.parent / words[1]))
    return found


def _intrinsics(folder: Path, given: Sequence[float] | None) -> Float[np.ndarray, "3 3"]:
    if given is not None:
        if len(given) != 4:
            raise ValueError(f"`intrinsics` must be (fx, fy, cx, cy), got {len(given)} numbers.")
        fx, fy, cx, cy = given
        return pinhole(fx, fy, cx, cy, where="`intrinsics`")
    path = next((p for name in _CAMERAS if (p := folder / name).is_file()), None)
    if path is None:
        raise ValueError(
            f"{folder} does not say its camera's intrinsics; give (fx, fy, cx, cy) in px "
            f"(`intrinsics`, --intrinsics) or a file {' or '.join(_CAMERAS)}."
        )
    if path.suffix == ".txt":
        words = path.read_text(encoding="utf-8-sig", errors="replace").split()
        fx, fy, cx, cy = _numbers(path, 1, words[:4], 4)
        return pinhole(fx, fy, cx, cy, where=str(path))
    try:
        # Open3D's: a 3x3 matrix by columns.
        matrix = json.loads(path.read_bytes())["intrinsic_matrix"]
        fx, fy, cx, cy = (float(matrix[i]) for i in (0, 4, 6, 7))
    except (ValueError, KeyError, TypeError, IndexError):
        raise ValueError(
            f"{path} has no `intrinsic_matrix` of nine numbers, by columns; expected Open3D's form."
        ) from None
    return pinhole(fx, fy, cx, cy, where=str(path))
