"""Portable float maps: one disparity or depth per pixel, as the benchmarks exchange them."""

import os
import re
import sys
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float

# Between the words of a header: blanks, line ends of any system, comments up to a line's end.
_GAP, _WORD = rb"(?:\s|#[^\n]*\n)+", rb"((?!#)\S{1,32})"
# The values begin after the line of the scale, or after a single blank.
_HEADER = re.compile(
    rb"(Pf|PF)" + 3 * (_GAP + _WORD) + rb"(?:[ \t]*\r?\n|\s)"  # width, height, scale
)
# Scale in Middlebury's files, to six digits, whose values are not scaled.
_MIDDLEBURY = 1 / 255


def read_pfm(path: str | os.PathLike) -> Float[np.ndarray, "y x"]:
    """Reads a single-channel portable float map.

    Values are divided by the magnitude of the header's scale, as in Netpbm and OpenCV, except for
    the scale 1/255 of Middlebury's files. A warning reports either case.

    Args:
        path: a `.pfm` file. It is stored bottom-up; the result is not.

    Returns:
        float32 values, row 0 at the top. NaN and infinities are kept.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not a PFM, has three channels, or another number of bytes than its
            header says.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_pfm(folder + "/d.pfm", np.array([[1.0, 2.0], [3.0, 4.0]]))
        ...     read_pfm(folder + "/d.pfm").tolist()
        [[1.0, 2.0], [3.0, 4.0]]
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not there; expected a portable float map (.pfm).")
    data = path.read_bytes()
    width, height, scale, start = _header(data, path)
    have, need = len(data) - start, 4 * width * height
    if have != need:
        fault = "is truncated" if have < need else "has bytes to spare"
        raise ValueError(
            f"{path} {fault}: expected {need} bytes for {width}x{height} values, found {have}."
        )
    order = "<f4" if scale < 0 else ">f4"
    values = np.frombuffer(data, order, width * height, start).reshape(height, width)
    values = np.ascontiguousarray(values[::-1], dtype=np.float32)
    return _scaled(values, abs(scale), path)


def _header(data: bytes, path: Path) -> tuple[int, int, float, int]:
    """Width, height, scale, and where the values start."""
    if data[:2] not in {b"Pf", b"PF"}:
        raise ValueError(
            f"{path} is not a portable float map: expected it to begin with 'Pf', found "
            f"{data[:8]!r}."
        )
    if data[:2] == b"PF":
        raise ValueError(f"{path} has three channels ('PF'); expected one value per pixel ('Pf').")
    match = _HEADER.match(data)
    try:
        if match is None:
            raise ValueError
        width, height, scale = int(match[2]), int(match[3]), float(match[4])
    except ValueError:
        raise ValueError(
            f"{path} has a broken header: expected 'Pf', width, height and a scale, found "
            f"{data[:24]!r}."
        ) from None
    if width < 1 or height < 1 or scale == 0 or not np.isfinite(scale):
        raise ValueError(
            f"{path} has a broken header: expected a positive size and a scale other than 0, found "
            f"{width}x{height} and {scale}."
        )
    return width, height, scale, match.end()


def _scaled(values: Float[np.ndarray, "y x"], scale: float, path: Path) -> Float[np.ndarray, "y x"]:
    """Values in the unit that a header's scale, not negative here, gives them."""
    if scale == 1:
        return values
    if abs(scale - _MIDDLEBURY) < 1e-6:
        warnings.warn(
            f"{path} has the scale {scale:g}, as Middlebury's files have; its values were read as "
            "they are stored.",
            stacklevel=3,
        )
        return values
    warnings.warn(
        f"{path} has the scale {scale:g}; its values were divided by it, as Netpbm and OpenCV do.",
        stacklevel=3,
    )
    with np.errstate(over="ignore"):
        return (values.astype(np.float64) / scale).astype(np.float32)


def write_pfm(path: str | os.PathLike, array: Float[np.ndarray, "y x"]) -> None:
    """Writes one value per pixel as a portable float map (little endian where the machine is).

    Args:
        path: the file to write; an existing one is replaced.
        array: values, row 0 at the top; stored as float32, NaN and infinities included.

    Raises:
        ValueError: if the array is not two-dimensional or is empty.
    """
    values = np.asarray(array, dtype=np.float32)
    if values.ndim != 2 or values.size == 0:
        raise ValueError(
            f"`array` must have two axes [y, x] and not be empty, got shape {values.shape}."
        )
    scale = -1.0 if sys.byteorder == "little" else 1.0
    header = f"Pf\n{values.shape[1]} {values.shape[0]}\n{scale}\n".encode("ascii")
    Path(path).write_bytes(header + np.ascontiguousarray(values[::-1]).tobytes())
