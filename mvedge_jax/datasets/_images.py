"""Reads image files with checks: a truncated picture is an error."""

import contextlib
import io
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Shaped
from PIL import Image

from ._png import SIGNATURE, DamagedPng, plain_png

_JPEG = b"\xff\xd8"
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
# Bytes within which a header tells the size; profiles and thumbnails of a JPEG come before it.
_HEAD = 4_000_000
# Transformations by the numbers of EXIF's tag 0x112 (orientation).
_ORIENTATION = 0x112
_TURNS = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}


def read_image(path: Path, *, upright: bool = True) -> Shaped[np.ndarray, "y x 3"]:
    """Reads an 8 or 16 bit PNG, JPEG or BMP file as RGB; gray becomes RGB, alpha is dropped.

    `upright` rotates a JPEG by its EXIF orientation, as viewers do. A file that is truncated,
    damaged, no image, or of another depth is a ValueError.
    """
    return _rgb(read_raw(path, upright=upright))


def read_cutout(
    path: Path, *, upright: bool = True
) -> tuple[Shaped[np.ndarray, "y x 3"], Bool[np.ndarray, "y x"] | None]:
    """As `read_image`; also where alpha is at least one half, None if that is everywhere.

    An image that is transparent everywhere is a ValueError, too.
    """
    pixels = read_raw(path, upright=upright)
    if pixels.ndim == 2 or pixels.shape[2] < 4:
        return _rgb(pixels), None
    opaque = pixels[..., 3] > np.iinfo(pixels.dtype).max // 2
    if not opaque.any():
        raise ValueError(f"{path} is transparent everywhere; expected pixels that show something.")
    return _rgb(pixels), None if opaque.all() else opaque


def _rgb(pixels: np.ndarray) -> Shaped[np.ndarray, "y x 3"]:
    if pixels.ndim == 2:
        return cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    if pixels.shape[2] == 4:
        return cv2.cvtColor(pixels, cv2.COLOR_BGRA2RGB)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def read_raw(path: Path, *, upright: bool = True) -> np.ndarray:
    """Reads the stored channels of a PNG, JPEG or BMP file as they are.

    Of a JPEG with more behind its end marker (motion photographs, MPO), the first image is read.

    Args:
        path: the file.
        upright: rotate a JPEG by its EXIF orientation, as viewers do.

    Returns:
        uint8 or uint16, `[y, x]` or `[y, x, bgr(a)]`.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is truncated, damaged, not an image, or of another depth.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; expected an image.")
    data = path.read_bytes()
    _size(path, data)
    problem, pixels = _damage(data), None
    if problem is None:
        try:
            pixels = _decoded(data, upright)
        except (DamagedPng, _TruncatedError) as damage:
            problem = str(damage)
    if problem is not None:
        raise ValueError(f"{path} cannot be read: {problem}; expected a complete image.")
    if pixels is None:
        raise ValueError(f"{path} cannot be decoded; expected a PNG, JPEG or BMP image.")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path} has {pixels.dtype} pixels; expected 8 or 16 bit.")
    return pixels


class _TruncatedError(ValueError):
    """A file that ends too early."""


def _decoded(data: bytes, upright: bool) -> np.ndarray | None:
    """The pixels, blue first as OpenCV has them; None if there are none.

    OpenCV reads PNG at any depth. Of other damaged files it would write to the terminal.
    """
    if data.startswith(SIGNATURE):
        try:
            return cv2.imdecode(np.frombuffer(plain_png(data), np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            return None
    if data.startswith(_JPEG):
        # Truncated downloads may be padded with zeros, which decode as pixels.
        data = data.rstrip(b"\0\r\n ")
    turn = _TURNS.get(_orientation(data)) if upright else None
    try:
        with _opened(data) as image:
            gray = image.mode in ("1", "L")
            plain = image.convert("L" if gray else "RGB")
            pixels = np.asarray(plain if turn is None else plain.transpose(turn))
    except (OSError, ValueError, SyntaxError, ArithmeticError, Image.DecompressionBombError) as no:
        ended = "truncated" not in str(no) and data.endswith(b"\xff\xd9")
        if data.startswith(_JPEG) and not ended:
            raise _TruncatedError("it is truncated (a JPEG)") from no
        return None
    return pixels if gray else np.ascontiguousarray(pixels[..., ::-1])


@contextlib.contextmanager
def _opened(data: bytes) -> Iterator[Image.Image]:
    """An image opened by Pillow, without its warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with Image.open(io.BytesIO(data)) as image:
            yield image


def image_orientation(path: Path) -> int:
    """The EXIF orientation of a JPEG file, 1 to 8; 1 (upright) without an entry."""
    with path.open("rb") as stream:
        return _orientation(stream.read(_HEAD))


def _orientation(data: bytes) -> int:
    if not data.startswith(_JPEG) or b"Exif\0\0" not in data[:_HEAD]:
        return 1
    try:
        with _opened(data) as image:
            found = image.getexif().get(_ORIENTATION, 1)
    # Broken EXIF data is ignored.
    except (OSError, ValueError, SyntaxError, ArithmeticError, KeyError, TypeError, struct.error):
        return 1
    return found if isinstance(found, int) and found in _TURNS else 1


def image_size(path: Path, *, upright: bool = True) -> tuple[int, int]:
    """Height and width of an image, px, from its header; nothing is decoded.

    A file of another type, or that ends before its size, is a ValueError.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; expected an image.")
    with path.open("rb") as stream:
        data = stream.read(_HEAD)
    height, width = _size(path, data)
    # From 5 on, rows become columns.
    return (width, height) if upright and _orientation(data) > 4 else (height, width)


def write_image(path: Path, pixels: np.ndarray) -> None:
    """Writes `[y, x]` or `[y, x, bgr]`, uint8 or uint16, as a PNG file."""
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


def _size(path: Path, data: bytes) -> tuple[int, int]:
    """Height and width from the beginning of a file."""
    found = None
    if data.startswith(SIGNATURE):
        width, height = struct.unpack(">II", data[16:24]) if len(data) >= 24 else (0, 0)
        found = height, width
    elif data.startswith(_JPEG):
        found = _jpeg_size(data)
    elif data.startswith(b"BM"):
        kind = "<HH" if data[14:18] == b"\x0c\0\0\0" else "<ii"
        width, height = struct.unpack_from(kind, data, 18) if len(data) >= 26 else (0, 0)
        found = abs(height), width
    elif data:
        raise ValueError(f"{path} cannot be decoded; expected a PNG, JPEG or BMP image.")
    if found is None or min(found) < 1:
        problem = "it is truncated before its size" if data else "it is empty"
        raise ValueError(f"{path} cannot be read: {problem}; expected a complete image.")
    return found


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """From the start-of-frame segment, which may follow long ones of other kinds."""
    position = 2
    while position + 9 <= len(data):
        marker = data[position + 1]
        if data[position] != 0xFF or marker == 0xDA:
            return None
        if marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01:  # no length follows
            position += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return struct.unpack(">HH", data[position + 5 : position + 9])
        position += 2 + struct.unpack(">H", data[position + 2 : position + 4])[0]
    return None


def _damage(data: bytes) -> str | None:
    """Damage that the decoder would not report; None without any."""
    if not data.startswith(b"BM"):
        return None
    size = struct.unpack("<I", data[2:6])[0] if len(data) >= 6 else 26
    return f"it is truncated ({len(data)} of {size} bytes)" if len(data) < size else None


def picked(values: np.ndarray, size: tuple[int, int], ratio: tuple[float, float]) -> np.ndarray:
    """Shrinks a map that must not be averaged, such as depth or labels, by its middle pixels.

    OpenCV's nearest interpolation takes the pixel in the corner. `size` is that of the result, px,
    `ratio` that of new to old pixels along y and x, at most 1.
    """
    y, x = (
        ((np.arange(few) + 0.5) / share).astype(int).clip(max=many - 1)
        for few, share, many in zip(size, ratio, values.shape, strict=True)
    )
    return values[np.ix_(y, x)]
