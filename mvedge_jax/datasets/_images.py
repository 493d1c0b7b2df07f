"""Image files, checked: what OpenCV would read as half a picture is an error here."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Shaped
from PIL import Image

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_PNG = b"\x89PNG\r\n\x1a\n"
# Bytes within which a header tells the size; profiles and thumbnails of a JPEG come before it.
_HEAD = 4_000_000


def read_image(path: Path) -> Shaped[np.ndarray, "y x 3"]:
    """Reads an 8 or 16 bit image as RGB; grey becomes RGB, an alpha channel is dropped.

    Args:
        path: a PNG, JPEG or BMP file.

    Returns:
        uint8 or uint16.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is truncated, damaged, not an image, or of another depth.
    """
    pixels = read_raw(path)
    if pixels.ndim == 2:
        return cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB)
    if pixels.shape[2] == 4:
        return cv2.cvtColor(pixels, cv2.COLOR_BGRA2RGB)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def read_raw(path: Path) -> np.ndarray:
    """Reads the stored channels of an image file as they are (`[y, x]` or `[y, x, bgr(a)]`).

    Args:
        path: a PNG, JPEG or BMP file.

    Returns:
        uint8 or uint16.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is truncated, damaged, not an image, or of another depth.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; expected an image.")
    data = path.read_bytes()
    _size(path, data)
    problem = _damage(data)
    if problem:
        raise ValueError(f"{path} cannot be read: {problem}; expected a complete image.")
    pixels = _decoded(data)
    if pixels is None:
        raise ValueError(f"{path} cannot be decoded; expected a PNG, JPEG or BMP image.")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path} has {pixels.dtype} pixels; expected 8 or 16 bit.")
    return pixels


def _decoded(data: bytes) -> np.ndarray | None:
    """The pixels, blue first as OpenCV has them; None if there are none.

    OpenCV reads PNG at any depth. Of other damaged files it would write to the terminal.
    """
    if data.startswith(_PNG):
        try:
            return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            return None
    try:
        with warnings.catch_warnings(), Image.open(io.BytesIO(data)) as image:
            warnings.simplefilter("ignore")
            grey = image.mode in ("1", "L")
            pixels = np.asarray(image.convert("L" if grey else "RGB"))
    except (OSError, ValueError, SyntaxError, ArithmeticError, Image.DecompressionBombError):
        return None
    return pixels if grey else np.ascontiguousarray(pixels[..., ::-1])


def image_size(path: Path) -> tuple[int, int]:
    """Height and width of an image from its header; nothing is decoded.

    Args:
        path: a PNG, JPEG or BMP file.

    Returns:
        In px.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is none of these, or ends before it tells.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing; expected an image.")
    with path.open("rb") as stream:
        return _size(path, stream.read(_HEAD))


def write_image(path: Path, pixels: np.ndarray) -> None:
    """Writes a PNG file, whatever the name of its folder.

    Args:
        path: the file.
        pixels: uint8 or uint16, `[y, x]` or `[y, x, bgr]`.

    Raises:
        OSError: if it cannot be written.
    """
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


def _size(path: Path, data: bytes) -> tuple[int, int]:
    """Height and width from the beginning of a file."""
    found = None
    if data.startswith(_PNG):
        width, height = struct.unpack(">II", data[16:24]) if len(data) >= 24 else (0, 0)
        found = height, width
    elif data.startswith(b"\xff\xd8"):
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
    """What is wrong with the file, None if nothing is or the format is unknown.

    OpenCV fills the missing part of a truncated file with grey and only prints a warning.
    """
    if not data:
        return "it is empty"
    if data.startswith(_PNG):
        return _png_damage(data)
    if data.startswith(b"\xff\xd8"):
        complete = data.rstrip(b"\0\r\n ").endswith(b"\xff\xd9")
        return None if complete else "it is truncated (a JPEG without its end marker)"
    if data.startswith(b"BM"):
        size = struct.unpack("<I", data[2:6])[0] if len(data) >= 6 else 26
        return f"it is truncated ({len(data)} of {size} bytes)" if len(data) < size else None
    return None


def _png_damage(data: bytes) -> str | None:
    position = 8
    while position + 12 <= len(data):
        length = struct.unpack(">I", data[position : position + 4])[0]
        end = position + 12 + length
        if end > len(data):
            return f"it is truncated at byte {len(data)} (a PNG)"
        chunk = memoryview(data)[position + 4 : end - 4]
        if zlib.crc32(chunk) != struct.unpack(">I", data[end - 4 : end])[0]:
            return f"it is damaged at byte {position} (a PNG checksum is wrong)"
        if chunk[:4] == b"IEND":
            return None
        position = end
    return f"it is truncated at byte {len(data)} (a PNG without its end)"


def picked(values: np.ndarray, size: tuple[int, int], ratio: tuple[float, float]) -> np.ndarray:
    """Shrinks what must not be mixed, depth or labels: every pixel is the one in its middle.

    OpenCV's nearest pixel is the one in the corner.

    Args:
        values: `[y, x]`.
        size: height and width of the result, px.
        ratio: of new to old pixels along y and x, at most 1.

    Returns:
        Values of `values`, `[y, x]`.
    """
    y, x = (
        ((np.arange(few) + 0.5) / share).astype(int).clip(max=many - 1)
        for few, share, many in zip(size, ratio, values.shape, strict=True)
    )
    return values[np.ix_(y, x)]
