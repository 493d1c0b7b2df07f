"""Portable float maps: one disparity or depth per pixel, as the benchmarks exchange them."""

import os
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float


def read_pfm(path: str | os.PathLike) -> Float[np.ndarray, "y x"]:
    """Reads a single-channel portable float map.

    Args:
        path: a `.pfm` file. It is stored bottom-up; the result is not.

    Returns:
        float32 values, row 0 at the top. NaN and infinities are kept.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if it is not a PFM, has three channels, or ends too early.

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
    fields, start = _header(data)
    if not fields or fields[0] not in {b"Pf", b"PF"}:
        raise ValueError(
            f"{path} is not a portable float map: expected it to begin with 'Pf', found "
            f"{data[:8]!r}."
        )
    if fields[0] == b"PF":
        raise ValueError(f"{path} has three channels ('PF'); expected one value per pixel ('Pf').")
    try:
        width, height, scale = int(fields[1]), int(fields[2]), float(fields[3])
    except (IndexError, ValueError) as error:
        raise ValueError(
            f"{path} has a broken header: expected 'Pf', width, height and a scale, found "
            f"{b' '.join(fields)[:24]!r}."
        ) from error
    if width < 1 or height < 1 or scale == 0 or not np.isfinite(scale):
        raise ValueError(
            f"{path} has a broken header: expected a positive size and a scale other than 0, found "
            f"{width}x{height} and {scale}."
        )
    have, need = len(data) - start, 4 * width * height
    if have < need:
        raise ValueError(
            f"{path} is truncated: expected {need} bytes for {width}x{height} values, found {have}."
        )
    order = "<f4" if scale < 0 else ">f4"
    values = np.frombuffer(data, order, width * height, start).reshape(height, width)
    return np.ascontiguousarray(values[::-1], dtype=np.float32)


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


def _header(data: bytes) -> tuple[list[bytes], int]:
    """The four words of the header and where the values start (one blank after the last word)."""
    fields, position = [], 0
    while len(fields) < 4:
        while position < len(data) and data[position : position + 1].isspace():
            position += 1
        end = position
        while end < len(data) and end - position < 32 and not data[end : end + 1].isspace():
            end += 1
        if end == position:
            break
        fields.append(data[position:end])
        position = end
    return fields, position + 1
