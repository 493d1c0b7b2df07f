"""Lytro light fields decoded to MATLAB files (EPFL data set, Light Field Toolbox)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import h5py
import numpy as np
import scipy.io

from ._hdf5 import dataset
from ._source import Source

_AXES = "[v, u, y, x, c]"


@contextmanager
def open_mat(path: Path) -> Iterator[Source]:
    """Opens a MAT file, version 7 or 7.3, with an array `LF` of 8 or 16 bit `[v, u, y, x, c]`.

    A fourth channel is the toolbox' weight and is dropped; one channel is grey.
    """
    with path.open("rb") as stream:
        head = stream.read(128)
    if h5py.is_hdf5(path):
        with _open_v73(path) as source:
            yield source
    elif head.startswith(b"MATLAB 7.3"):
        raise ValueError(f"{path} is truncated: a version 7.3 header without its HDF5 contents.")
    else:
        yield _open_v7(path)


@contextmanager
def _open_v73(path: Path) -> Iterator[Source]:
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise ValueError(f"{path} is truncated or damaged: {error}.") from error
    with file:
        stored = dataset(file, "LF", path, f"MATLAB axes {_AXES}", 5)
        # MATLAB stores column-major, so that HDF5 sees the axes in reverse.
        _check(path, stored.shape[::-1], stored.dtype)
        yield _source(
            path,
            stored.shape[::-1],
            lambda row, column: stored[..., column, row].transpose(2, 1, 0),
        )


def _open_v7(path: Path) -> Source:
    try:
        variables = scipy.io.loadmat(path, variable_names=["LF"])
        names = [name for name, *_ in scipy.io.whosmat(path)]
    except Exception as error:  # SciPy raises many kinds for a damaged file
        raise ValueError(
            f"{path} cannot be read as a MATLAB file (truncated or of another format): {error}."
        ) from error
    if "LF" not in variables:
        found = ", ".join(names) or "nothing"
        raise ValueError(f"{path} holds no array `LF` (it has: {found}); expected {_AXES}.")
    stored = variables["LF"]
    _check(path, stored.shape, stored.dtype)
    return _source(path, stored.shape, lambda row, column: stored[row, column])


def _check(path: Path, shape: tuple[int, ...], dtype: np.dtype) -> None:
    if len(shape) != 5:
        raise ValueError(
            f"`LF` in {path} has {len(shape)} dimensions (shape {shape}); expected 5, {_AXES}."
        )
    if dtype not in (np.uint8, np.uint16):
        raise ValueError(f"`LF` in {path} is {dtype}; expected uint8 or uint16.")
    if shape[4] not in (1, 3, 4):
        raise ValueError(
            f"`LF` in {path} has {shape[4]} channels (shape {shape}); expected {_AXES} with 3, 4 "
            "(colour and weight) or 1."
        )


def _source(path: Path, shape: tuple[int, ...], view) -> Source:
    def read(row: int, column: int) -> np.ndarray:
        image = np.ascontiguousarray(view(row, column)[..., :3])
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.shape[2] == 1 else image

    return Source(
        name=path.stem,
        layout="Lytro (MATLAB file)",
        available=np.ones(shape[:2], bool),
        read=read,
        label=lambda row, column: f"{path}: LF({row + 1}, {column + 1})",
    )
