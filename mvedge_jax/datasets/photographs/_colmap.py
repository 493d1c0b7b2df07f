"""COLMAP's sparse models, text and binary; with or without its newer `rigs` and `frames` files."""

import dataclasses
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ._posed_source import Frame, Lens, PosedSource, pinhole, rigid, rotation_of

# Name -> number in binary files, number of parameters, order of focal lengths, principal point and
# OpenCV's distortion among them (None: a coefficient that the model does not have).
_ONE, _TWO = (0, 0, 1, 2), (0, 1, 2, 3)


@dataclasses.dataclass(frozen=True)
class _Model:
    number: int
    count: int
    pinhole: tuple[int, int, int, int]
    distortion: tuple[int | None, ...] | None = None
    fisheye: bool = False


_MODELS = {
    "SIMPLE_PINHOLE": _Model(0, 3, _ONE),
    "PINHOLE": _Model(1, 4, _TWO),
    "SIMPLE_RADIAL": _Model(2, 4, _ONE, (3, None, None, None)),
    "RADIAL": _Model(3, 5, _ONE, (3, 4, None, None)),
    "OPENCV": _Model(4, 8, _TWO, (4, 5, 6, 7)),
    "OPENCV_FISHEYE": _Model(5, 8, _TWO, (4, 5, 6, 7), fisheye=True),
    "FULL_OPENCV": _Model(6, 12, _TWO, (4, 5, 6, 7, 8, 9, 10, 11)),
    "SIMPLE_RADIAL_FISHEYE": _Model(8, 4, _ONE, (3, None, None, None), fisheye=True),
    "RADIAL_FISHEYE": _Model(9, 5, _ONE, (3, 4, None, None), fisheye=True),
}
_NUMBERS = {model.number: name for name, model in _MODELS.items()}
# COLMAP has pixel centers at .5.
_HALF = 0.5


@dataclasses.dataclass(frozen=True)
class _Image:
    number: int
    name: str
    world_to_camera: Float[np.ndarray, "4 4"]
    camera: int


@dataclasses.dataclass(frozen=True)
class _Points:
    xyz: Float[np.ndarray, "m 3"]
    # For every point, the numbers of the images that observed it.
    tracks: list[np.ndarray]


def find_colmap(path: Path) -> Path | None:
    """The folder of a COLMAP model: `path`, `sparse` or `sparse/0` in it; None without one."""
    for folder in (path, path / "sparse", path / "sparse" / "0"):
        if any((folder / f"{name}{end}").is_file() for name, end in _files()):
            return folder
    return None


def _files() -> Iterator[tuple[str, str]]:
    yield from ((name, end) for name in ("cameras", "images") for end in (".bin", ".txt"))


def open_colmap(folder: Path, images: Path | None) -> PosedSource:
    """Opens a COLMAP model: its photographs in the order of their names.

    The folder has `cameras`, `images` and perhaps `points3D`, `.bin` or `.txt`. Without a folder of
    `images`, one of this name is looked for beside or above the model. Errors name the file.
    """
    end = ".bin" if (folder / "images.bin").is_file() else ".txt"
    for name in ("cameras", "images"):
        if not (folder / f"{name}{end}").is_file():
            raise FileNotFoundError(
                f"{folder / (name + end)} is missing; a COLMAP model has cameras{end} and "
                f"images{end}."
            )
    read: tuple[Callable[[Path], Any], ...] = (
        (_cameras_binary, _images_binary, _points_binary)
        if end == ".bin"
        else (_cameras_text, _images_text, _points_text)
    )
    lenses = read[0](folder / f"cameras{end}")
    stored = sorted(read[1](folder / f"images{end}"), key=lambda image: image.name)
    if len(stored) < 2:
        raise ValueError(
            f"{folder / ('images' + end)} holds {len(stored)} images; expected at least two."
        )
    place = _image_folder(folder, images)
    frames = []
    for image in stored:
        where = f"{folder / ('images' + end)}, image {image.name},"
        if image.camera not in lenses:
            raise ValueError(
                f"{where} is of camera {image.camera}, which cameras{end} does not hold; expected "
                f"one of {sorted(lenses)}."
            )
        pose = np.linalg.inv(rigid(image.world_to_camera, where=where))
        # COLMAP reads images as they are stored.
        lens = lenses[image.camera]
        frames.append(Frame(image.name, place / image.name, pose, lens, upright=False))
    points = observed = None
    if (folder / f"points3D{end}").is_file():
        found = read[2](folder / f"points3D{end}")
        if len(found.xyz):
            points = found.xyz
            numbers = np.asarray([image.number for image in stored])
            observed = np.stack([np.isin(numbers, track) for track in found.tracks], axis=1)
            # Points without tracks: the observing images are unknown.
            observed = observed if observed.any() else None
    return PosedSource(f"COLMAP model ({end[1:]})", tuple(frames), points, observed)


def _image_folder(folder: Path, images: Path | None) -> Path:
    if images is not None:
        return images
    tried = [folder / "images", folder.parent / "images", folder.parent.parent / "images"]
    for place in tried:
        if place.is_dir():
            return place
    raise FileNotFoundError(
        f"{folder} has no folder of images beside it; looked for {', '.join(map(str, tried))}. "
        "Name it (`images`, --images)."
    )


def _lens(name: str, size: tuple[int, int], values: np.ndarray, where: str) -> Lens:
    model = _MODELS[name]
    if min(size) < 1:
        raise ValueError(f"{where} has {size[1]}x{size[0]} px; expected positive sizes.")
    fx, fy, cx, cy = (float(values[i]) for i in model.pinhole)
    matrix = pinhole(fx, fy, cx - _HALF, cy - _HALF, where=where, size=size)
    if model.distortion is None:
        return Lens(size, matrix)
    bent = tuple(0.0 if i is None else float(values[i]) for i in model.distortion)
    if not np.isfinite(bent).all():
        raise ValueError(f"{where} has a distortion that is not finite: {bent}.")
    return Lens(size, matrix, bent if any(bent) or model.fisheye else None, model.fisheye)


def _unknown(where: str, model: object) -> ValueError:
    return ValueError(
        f"{where} has the camera model {model}, which is not handled; expected one of "
        f"{', '.join(_MODELS)}. COLMAP's image_undistorter makes a model with PINHOLE cameras."
    )


class _Reader:
    """A binary file, read from its start; every read is checked against the remaining size."""

    def __init__(self, path: Path):
        self.path, self.data, self.place = path, path.read_bytes(), 0

    def numbers(self, form: str) -> tuple[Any, ...]:
        size = struct.calcsize("<" + form)
        self._need(size)
        self.place += size
        return struct.unpack_from("<" + form, self.data, self.place - size)

    def array(self, dtype: np.dtype, count: int) -> np.ndarray:
        self._need(count * dtype.itemsize)
        self.place += count * dtype.itemsize
        return np.frombuffer(self.data, dtype, count, self.place - count * dtype.itemsize)

    def count(self, least: int) -> int:
        """Reads a number of records, each of at least `least` bytes."""
        (count,) = self.numbers("Q")
        self._need(count * least)
        return count

    def text(self) -> str:
        end = self.data.find(b"\0", self.place)
        if end < 0:
            self._need(len(self.data) + 1)
        start, self.place = self.place, end + 1
        return self.data[start:end].decode("utf-8", "replace")

    def _need(self, size: int) -> None:
        left = len(self.data) - self.place
        if size > left:
            raise ValueError(
                f"{self.path} is truncated or damaged: {size} more bytes are announced at byte "
                f"{self.place}, {left} are there."
            )


def _cameras_binary(path: Path) -> dict[int, Lens]:
    reader, result = _Reader(path), {}
    for _ in range(reader.count(24)):
        number, model, width, height = reader.numbers("iiQQ")
        where = f"{path}, camera {number},"
        if model not in _NUMBERS:
            raise _unknown(where, f"number {model}")
        name = _NUMBERS[model]
        values = reader.array(np.dtype("<f8"), _MODELS[name].count)
        result[number] = _lens(name, (height, width), values, where)
    return result


def _images_binary(path: Path) -> list[_Image]:
    reader, result = _Reader(path), []
    point = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
    for _ in range(reader.count(73)):
        (number,) = reader.numbers("i")
        pose = reader.array(np.dtype("<f8"), 7)
        (camera,) = reader.numbers("i")
        name = reader.text()
        reader.array(point, reader.count(point.itemsize))
        result.append(_Image(number, name, _pose(pose, f"{path}, image {name},"), camera))
    return result


def _points_binary(path: Path) -> _Points:
    reader = _Reader(path)
    track = np.dtype([("image", "<i4"), ("feature", "<i4")])
    places, tracks = [], []
    for _ in range(reader.count(51)):
        _, x, y, z, *_ = reader.numbers("QdddBBBd")
        places.append((x, y, z))
        tracks.append(reader.array(track, reader.count(track.itemsize))["image"])
    return _checked_points(np.asarray(places, np.float64).reshape(-1, 3), tracks, path)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, comments left out; empty ones count: an image may have no point."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not text; expected a COLMAP model in text form.") from None
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.startswith("#"):
            yield number, line.strip()


def _rows(path: Path, least: int, what: str) -> Iterator[tuple[int, list[str]]]:
    """Fields of the lines that are not empty, at least so many."""
    for line, text in _lines(path):
        words = text.split()
        if 0 < len(words) < least:
            raise _short(path, line, len(words), what)
        if words:
            yield line, words


def _numbers(words: list[str], path: Path, line: int, what: str) -> np.ndarray:
    try:
        return np.asarray([float(word) for word in words])
    except ValueError:
        raise ValueError(
            f"{path}, line {line}: {' '.join(words)[:60]!r} are no numbers; expected {what}."
        ) from None


def _short(path: Path, line: int, found: int, what: str) -> ValueError:
    return ValueError(f"{path}, line {line}, has {found} fields; expected {what}.")


def _cameras_text(path: Path) -> dict[int, Lens]:
    result = {}
    for line, words in _rows(path, 5, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"):
        where = f"{path}, line {line},"
        if words[1] not in _MODELS:
            raise _unknown(where, words[1])
        values = _numbers(words[4:], path, line, "camera parameters")
        if len(values) != _MODELS[words[1]].count:
            wanted = f"{_MODELS[words[1]].count} parameters of {words[1]}"
            raise _short(path, line, len(values), wanted)
        number, width, height = (
            int(v) for v in _numbers([words[0], *words[2:4]], path, line, "whole numbers")
        )
        result[number] = _lens(words[1], (height, width), values, where)
    return result


def _images_text(path: Path) -> list[_Image]:
    lines, result = list(_lines(path)), []
    while lines and not lines[0][1]:
        lines.pop(0)
    # Every second line lists the points of the image before it, and may be empty.
    for i, (line, text) in enumerate(lines[::2]):
        words = text.split(maxsplit=9)
        if not words and not any(rest for _, rest in lines[2 * i :]):
            break
        for below, seen in lines[2 * i + 1 : 2 * i + 2]:
            if len(seen.split()) % 3 or not _all_numbers(seen.split()):
                raise ValueError(
                    f"{path}, line {below}: {seen[:60]!r}; expected the points of the image of "
                    f"line {line}, three numbers each, or an empty line."
                )
        if len(words) < 10:
            wanted = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            raise _short(path, line, len(words), wanted)
        values = _numbers(words[:9], path, line, "numbers of image, pose and camera")
        where = f"{path}, line {line},"
        pose = _pose(values[1:8], where)
        result.append(_Image(int(values[0]), words[9], pose, int(values[8])))
    return result


def _all_numbers(words: list[str]) -> bool:
    try:
        return bool(np.isfinite([float(word) for word in words]).all())
    except ValueError:
        return False


def _points_text(path: Path) -> _Points:
    places, tracks = [], []
    for line, words in _rows(path, 8, "POINT3D_ID X Y Z R G B ERROR TRACK[]"):
        values = _numbers(words, path, line, "numbers")
        places.append(values[1:4])
        tracks.append(values[8::2].astype(int))
    return _checked_points(np.asarray(places, np.float64).reshape(-1, 3), tracks, path)


def _checked_points(xyz: np.ndarray, tracks: list[np.ndarray], path: Path) -> _Points:
    if not np.isfinite(xyz).all():
        raise ValueError(f"{path} holds points that are not finite; expected finite places.")
    return _Points(xyz, tracks)


def _pose(values: np.ndarray, where: str) -> Float[np.ndarray, "4 4"]:
    result = np.eye(4)
    result[:3, :3] = rotation_of(values[:4], where=where)
    result[:3, 3] = values[4:7]
    return result
