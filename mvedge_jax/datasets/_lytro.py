"""Lytro light fields decoded to MATLAB files (EPFL data set, Light Field Toolbox)."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import scipy.io

from ._hdf5 import blamed, dataset, opened
from ._limits import check_grid, check_memory, plain_name, some
from ._mat import check_elements
from ._source import Source

_AXES = "[v, u, y, x, c]"


@contextmanager
def open_mat(path: Path, limit: float) -> Iterator[Source]:
    """Opens a MAT file, version 7 or 7.3, with an array `LF` of 8 or 16 bit `[v, u, y, x, c]`.

    A fourth channel is the toolbox' weight and is dropped; one channel is grey. An array of more
    than `limit` bytes is refused.
    """
    with path.open("rb") as stream:
        head = stream.read(128)
    if h5py.is_hdf5(path):
        with _open_v73(path, limit) as source:
            yield source
    elif head.startswith(b"MATLAB 7.3"):
        raise ValueError(f"{path} is truncated: a version 7.3 header without its HDF5 contents.")
    else:
        yield _open_v7(path, limit)


@contextmanager
def _open_v73(path: Path, limit: float) -> Iterator[Source]:
    with opened(path) as file:
        axes = f"MATLAB axes {_AXES}"
        with blamed(path):
            stored = dataset(file, "LF", path, axes, 5, limit, whole=False)
        # MATLAB stores column-major, so that HDF5 sees the axes in reverse.
        _check(path, stored.shape[::-1], str(stored.dtype))

        def read(row: int, column: int) -> np.ndarray:
            with blamed(path):
                return stored[..., column, row].transpose(2, 1, 0)

        yield _source(path, stored.shape[::-1], read)


def _open_v7(path: Path, limit: float) -> Source:
    check_elements(path, limit)
    held = {name: rest for name, *rest in _by_scipy(path, scipy.io.whosmat)}
    if "LF" not in held:
        raise ValueError(f"{path} holds no array `LF` (it has: {some(held)}); expected {_AXES}.")
    shape, kind = held["LF"]
    _check(path, shape, {"double": "float64", "single": "float32"}.get(kind, str(kind)))
    check_memory(f"`LF` in {path}", shape, limit, size=2)
    stored = _by_scipy(path, lambda path: scipy.io.loadmat(path, variable_names=["LF"])["LF"])
    return _source(path, stored.shape, lambda row, column: stored[row, column])


def _by_scipy(path: Path, read: Callable[[Path], Any]) -> Any:
    try:
        return read(path)
    except MemoryError:
        raise
    except Exception as error:  # SciPy raises many kinds for a damaged file
        reason = " ".join(str(error).split())[:200].rstrip(".")
        raise ValueError(
            f"{path} cannot be read as a MATLAB file (truncated or of another format): {reason}."
        ) from error


def _check(path: Path, shape: tuple[int, ...], kind: str) -> None:
    if len(shape) != 5:
        raise ValueError(
            f"`LF` in {path} has {len(shape)} dimensions (shape {shape}); expected 5, {_AXES}."
        )
    if kind not in ("uint8", "uint16"):
        raise ValueError(f"`LF` in {path} is {kind}; expected uint8 or uint16.")
    if shape[4] not in (1, 3, 4):
        raise ValueError(
            f"`LF` in {path} has {shape[4]} channels (shape {shape}); expected {_AXES} with 3, 4 "
            "(colour and weight) or 1."
        )
    if min(shape) < 1:
        raise ValueError(f"`LF` in {path} is empty (shape {shape}); expected {_AXES}.")
    check_grid(path, *shape[:2])


def _source(path: Path, shape: tuple[int, ...], view) -> Source:
    def read(row: int, column: int) -> np.ndarray:
        image = np.ascontiguousarray(view(row, column)[..., :3])
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.shape[2] == 1 else image

    return Source(
        name=plain_name(path.with_suffix("")),
        layout="Lytro (MATLAB file)",
        available=np.ones(shape[:2], bool),
        read=read,
        label=lambda row, column: f"{path}: LF({row + 1}, {column + 1})",
        header=lambda row, column: (shape[2], shape[3]),
    )
