"""Image files, checked: what OpenCV would read as half a picture is an error here."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Shaped

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")


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
    problem = _damage(data)
    if problem:
        raise ValueError(f"{path} cannot be read: {problem}; expected a complete image.")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ValueError(f"{path} cannot be decoded; expected a PNG, JPEG or BMP image.")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path} has {pixels.dtype} pixels; expected 8 or 16 bit.")
    return pixels


def _damage(data: bytes) -> str | None:
    """What is wrong with the file, None if nothing is or the format is unknown.

    OpenCV fills the missing part of a truncated file with grey and only prints a warning.
    """
    if not data:
        return "it is empty"
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
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
