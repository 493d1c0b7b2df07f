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
_CHANNELS = (1, 3, 4)
# Orders of the axes that are read.
_GRID_FIRST, _GRID_LAST = "vuyxc", "yxvuc"
# A grid has fewer views along a side than these have pixels; so many times fewer leave no doubt.
_CLEAR = 2


@contextmanager
def open_mat(path: Path, limit: float) -> Iterator[Source]:
    """Opens a MAT file, version 7 or 7.3, with an array `LF` of 8 or 16 bit `[v, u, y, x, c]`.

    A fourth channel is the toolbox' weight and is dropped; one channel is gray. An array of more
    than `limit` bytes is refused. The lengths of its axes decide whether it is `[y, x, v, u, c]`
    instead, and whether h5py wrote it without MATLAB, which reverses the axes.
    """
    with path.open("rb") as stream:
        head = stream.read(128)
    if h5py.is_hdf5(path):
        with _open_v73(path, limit, by_matlab=head.startswith(b"MATLAB")) as source:
            yield source
    elif head.startswith(b"MATLAB 7.3"):
        raise ValueError(f"{path} is truncated: a version 7.3 header without its HDF5 contents.")
    else:
        yield _open_v7(path, limit)


@contextmanager
def _open_v73(path: Path, limit: float, *, by_matlab: bool) -> Iterator[Source]:
    with opened(path) as file:
        with blamed(path):
            stored = dataset(file, "LF", path, f"MATLAB axes {_AXES}", 5, limit, whole=False)
        # MATLAB stores column-major, so that HDF5 sees the axes in reverse.
        turned, kind = stored.shape[::-1], str(stored.dtype)
        if not by_matlab and _plausible(stored.shape) and not _plausible(turned):
            axes = _checked(path, stored.shape, kind)
        else:
            axes = _checked(path, turned, kind)[::-1]
        whole: Any = stored
        if axes in (_GRID_LAST, _GRID_LAST[::-1]):  # the pixels of a view are spread over the file
            check_memory(f"`LF` in {path}", stored.shape, limit, size=2)
            with blamed(path):
                whole = stored[:]

        def read(index: tuple[Any, ...]) -> np.ndarray:
            with blamed(path):
                return whole[index]

        yield _source(path, stored.shape, axes, read)


def _open_v7(path: Path, limit: float) -> Source:
    check_elements(path, limit)
    held = {name: rest for name, *rest in _by_scipy(path, scipy.io.whosmat)}
    if "LF" not in held:
        raise ValueError(f"{path} holds no array `LF` (it has: {some(held)}); expected {_AXES}.")
    shape, kind = held["LF"]
    axes = _checked(path, shape, {"double": "float64", "single": "float32"}.get(kind, str(kind)))
    check_memory(f"`LF` in {path}", shape, limit, size=2)
    stored = _by_scipy(path, lambda path: scipy.io.loadmat(path, variable_names=["LF"])["LF"])
    return _source(path, stored.shape, axes, lambda index: stored[index])


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


def _checked(path: Path, shape: tuple[int, ...], kind: str) -> str:
    """The order of the axes of an array that can be read."""
    if len(shape) != 5:
        raise ValueError(
            f"`LF` in {path} has {len(shape)} dimensions (shape {shape}); expected 5, {_AXES}."
        )
    if kind not in ("uint8", "uint16"):
        raise ValueError(f"`LF` in {path} is {kind}; expected uint8 or uint16.")
    if shape[4] not in _CHANNELS:
        raise ValueError(
            f"`LF` in {path} has {shape[4]} channels (shape {shape}); expected {_AXES} with 3, 4 "
            "(color and weight) or 1."
        )
    if min(shape) < 1:
        raise ValueError(f"`LF` in {path} is empty (shape {shape}); expected {_AXES}.")
    first, second = shape[:2], shape[2:4]
    grid_last = min(first) > max(second)
    if grid_last and min(first) < _CLEAR * max(second):
        one, other = (f"{a}x{b}" for a, b in (first, second))
        raise ValueError(
            f"`LF` in {path} (shape {shape}) is either {one} views of {other} px, as {_AXES}, or "
            f"{other} views of {one} px, as [y, x, v, u, c]; expected views with more pixels than "
            "there are views along a side."
        )
    check_grid(path, *(second if grid_last else first))
    return _GRID_LAST if grid_last else _GRID_FIRST


def _plausible(shape: tuple[int, ...]) -> bool:
    """Whether the last of the axes may be channels, and one pair of the others a grid of views."""
    first, second = shape[:2], shape[2:4]
    apart = max(first) <= min(second) or max(second) <= min(first)
    return shape[4] in _CHANNELS and apart


def _source(
    path: Path, shape: tuple[int, ...], axes: str, read: Callable[[tuple[Any, ...]], np.ndarray]
) -> Source:
    """The source of an array with axes of these names, and a function that reads a part."""
    sides = dict(zip(axes, shape, strict=True))
    order = [axis for axis in axes if axis in "yxc"]
    usual = axes in (_GRID_FIRST, _GRID_FIRST[::-1])

    def view(row: int, column: int) -> np.ndarray:
        places = {"v": row, "u": column}
        part = read(tuple(places.get(axis, slice(None)) for axis in axes))
        image = np.ascontiguousarray(part.transpose([order.index(axis) for axis in "yxc"])[..., :3])
        return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.shape[2] == 1 else image

    before = "" if usual else ":, :, "
    return Source(
        name=plain_name(path.with_suffix("")),
        layout="Lytro (MATLAB file)" if usual else "Lytro (MATLAB file, [y, x, v, u, c])",
        available=np.ones((sides["v"], sides["u"]), bool),
        read=view,
        label=lambda row, column: f"{path}: LF({before}{row + 1}, {column + 1})",
        header=lambda row, column: (sides["y"], sides["x"]),
    )
