"""The old HCI (Wanner) benchmark: one HDF5 file with views, depth and labels of every view."""

import functools
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from mvedge_jax.lightfield import Camera

from ._limits import check_grid, check_memory, plain_name, some
from ._source import Source, Truth, check_truth


@contextmanager
def open_hdf5(path: Path, limit: float) -> Iterator[Source]:
    """Opens an HDF5 file of the old HCI benchmark.

    `LF` is uint8 `[v, u, y, x, c]`, `GT_DEPTH` and `GT_LABELS` are `[v, u, y, x]`. The disparity
    is `dH focalLength / depth - shift`, focal length in pixels.

    The archive's cameras do not all move in the same direction. Where there is ground truth, the
    view axes are put into the order in which the views agree with it; where there is none, the
    columns are reversed, as its rendered scenes need.

    `limit` is the largest size of the ground truth, which is read for this order, in bytes.
    """
    with opened(path) as file:
        with blamed(path):
            source = _source(file, path, limit)
        yield source


def _source(file: h5py.File, path: Path, limit: float) -> Source:
    views = dataset(file, "LF", path, "[v, u, y, x, c]", 5, limit, whole=False)
    if views.dtype != np.uint8:
        raise ValueError(f"`LF` in {path} is {views.dtype}; expected uint8.")
    if views.shape[4] != 3:
        raise ValueError(
            f"`LF` in {path} has {views.shape[4]} color channels (shape {views.shape}); "
            "expected [v, u, y, x, c] with 3."
        )
    if min(views.shape[:2]) > max(views.shape[2:4]):
        one, other = (f"{a}x{b}" for a, b in (views.shape[:2], views.shape[2:4]))
        raise ValueError(
            f"`LF` in {path} has {one} views of {other} px (shape {views.shape}, [v, u, y, x, c]); "
            f"expected views with more pixels than there are views along a side. If it has {other} "
            f"views of {one} px, store it as [v, u, y, x, c]."
        )
    check_grid(path, *views.shape[:2])
    truth = _truth_reader(file, path, views.shape[:4], limit)
    flip_v, flip_u = (False, True) if truth is None else _view_order(views, truth())

    def read(row: int, column: int) -> np.ndarray:
        with blamed(path):
            return views[row, column]

    return Source(
        name=plain_name(path.with_suffix("")),
        layout="old HCI benchmark (HDF5)",
        available=np.ones(views.shape[:2], bool),
        read=read,
        label=lambda row, column: f"{path}: LF[{row}, {column}]",
        truth=truth,
        camera=_camera(file, path),
        header=lambda row, column: views.shape[2:4],
        flip_v=flip_v,
        flip_u=flip_u,
    )


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file, closed on the way out."""
    with blamed(path):
        file = h5py.File(path, "r")
    with file:
        yield file


@contextmanager
def blamed(path: Path) -> Iterator[None]:
    """Adds the name of the file to errors of HDF5 in the body."""
    try:
        yield
    except (OSError, RuntimeError, KeyError) as error:
        reason = " ".join(str(error).split())[:200].rstrip(".")
        raise ValueError(
            f"{path} cannot be read as an HDF5 file (truncated, damaged or of another format): "
            f"{reason}."
        ) from error


def dataset(
    file: h5py.File,
    name: str,
    path: Path,
    axes: str,
    rank: int,
    limit: float,
    *,
    whole: bool = True,
) -> h5py.Dataset:
    """The dataset `name`, after checks of its existence, axes and memory.

    If it is not read as a whole, memory is that of the largest chunk that HDF5 unpacks at once.
    """
    kind = file.get(name, getlink=True) if name in file else None
    found = file.get(name) if isinstance(kind, h5py.HardLink) else None
    if not isinstance(found, h5py.Dataset):
        raise ValueError(f"{path} holds no array `{name}` (it has: {some(file)}); expected {axes}.")
    if found.external or found.is_virtual:
        # An external link could name any file of the machine, or a pipe, which has no end.
        raise ValueError(f"`{name}` in {path} lies in other files; expected it in the file itself.")
    if found.ndim != rank:
        raise ValueError(
            f"`{name}` in {path} has {found.ndim} dimensions (shape {found.shape}); expected "
            f"{rank}, {axes}."
        )
    if found.dtype.kind not in "uif":
        raise ValueError(f"`{name}` in {path} is {found.dtype}; expected numbers.")
    if min(found.shape) < 1:
        raise ValueError(f"`{name}` in {path} is empty (shape {found.shape}); expected {axes}.")
    for shape in (found.shape if whole else (), found.chunks or ()):
        check_memory(f"`{name}` in {path}", shape, limit, size=max(4, found.dtype.itemsize))
    return found


def _attribute(file: h5py.File, path: Path, name: str) -> float | None:
    value = file.attrs.get(name)
    if value is None:
        return None
    try:
        number = float(np.ravel(value)[0])
    except (TypeError, ValueError, IndexError):
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(
            f"The attribute {name} of {path} is {str(value)[:60]}; expected a finite number."
        )
    return number


def _camera(file: h5py.File, path: Path) -> Camera | None:
    names = ("dH", "focalLength", "shift")
    baseline, focal, shift = (_attribute(file, path, name) for name in names)
    if baseline is None or focal is None or shift is None or baseline <= 0 or focal <= 0:
        return None
    # shift = focal * baseline / (distance of zero disparity)
    return Camera(focal, baseline, focal * baseline / shift if shift > 0 else float("inf"))


def _truth_reader(file: h5py.File, path: Path, shape: tuple[int, ...], limit: float):
    if "GT_DEPTH" not in file:
        return None
    axes, labeled = "[v, u, y, x]", "GT_LABELS" in file
    depth = dataset(file, "GT_DEPTH", path, axes, 4, limit)
    labels = dataset(file, "GT_LABELS", path, axes, 4, limit) if labeled else None
    for name, array in (("GT_DEPTH", depth), ("GT_LABELS", labels)):
        if array is not None and array.shape != shape:
            raise ValueError(
                f"`{name}` in {path} has the shape {array.shape}; expected that of the views, "
                f"{shape}."
            )
    constants = {name: _attribute(file, path, name) for name in ("dH", "focalLength", "shift")}
    missing = [name for name, value in constants.items() if value is None]
    if missing:
        raise ValueError(
            f"{path} has `GT_DEPTH` but lacks the attribute {', '.join(missing)}; expected dH, "
            "focalLength and shift, which turn depth into disparity."
        )
    baseline, focal, shift = (float(value) for value in constants.values() if value is not None)
    center = shape[0] // 2, shape[1] // 2

    @functools.cache  # the order of the views and the light field both need it
    def read() -> Truth:
        with np.errstate(over="ignore"):  # too large numbers become infinite and are refused as
            # such
            values = depth[:].astype(np.float32)
        check_truth(values, f"{path}: GT_DEPTH", "depth")
        known = values > 0
        if not known.any():
            raise ValueError(f"{path}: GT_DEPTH has no positive value; expected distances.")
        with np.errstate(over="ignore", invalid="ignore"):
            distance = np.where(known, values, 1).astype(np.float64)
            disparity = np.where(known, baseline * focal / distance - shift, 0).astype(np.float32)
        check_truth(disparity, f"{path}: the disparity of GT_DEPTH")
        ids = None if labels is None else labels[:]
        if ids is not None:
            check_truth(ids, f"{path}: GT_LABELS", "label")
            ids = ids.astype(np.int32)
        # Only a complete set of maps is passed on: there is no mask per view.
        return Truth(
            disparity[center],
            known[center],
            None if ids is None else ids[center],
            disparity if known.all() else None,
            ids,
        )

    return read


def _view_order(views: h5py.Dataset, truth: Truth) -> tuple[bool, bool]:
    """Whether rows and columns of views must be reversed to agree with the ground truth."""
    vc, uc = views.shape[0] // 2, views.shape[1] // 2
    center = views[vc, uc].astype(np.float32)
    flips = []
    for axis, (count, middle) in enumerate(zip(views.shape[:2], (vc, uc), strict=True)):
        if count < 3:
            flips.append(False)
            continue
        place = (middle - 1, uc) if axis == 0 else (vc, middle - 1)
        view = views[place].astype(np.float32)
        # The view before the center sees a point at +d by the convention, at -d if reversed.
        errors = [_difference(center, view, sign * truth.disparity, axis) for sign in (1, -1)]
        flips.append(bool(errors[1] < errors[0]))
    return flips[0], flips[1]


def _difference(center: np.ndarray, view: np.ndarray, shift: np.ndarray, axis: int) -> float:
    y, x = np.indices(shift.shape)
    limit = shift.shape[axis]
    place = (y if axis == 0 else x) + np.rint(shift.clip(-limit, limit)).astype(int)
    inside = (place >= 0) & (place < limit)
    place = place.clip(0, limit - 1)
    seen = view[place, x] if axis == 0 else view[y, place]
    return float(np.abs(seen - center)[inside].mean()) if inside.any() else 0.0
