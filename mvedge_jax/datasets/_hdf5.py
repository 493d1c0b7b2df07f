"""The old HCI (Wanner) benchmark: one HDF5 file with views, depth and labels of every view."""

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from mvedge_jax.lightfield import Camera

from ._source import Source, Truth, check_truth


@contextmanager
def open_hdf5(path: Path) -> Iterator[Source]:
    """Opens an HDF5 file of the old HCI benchmark.

    `LF` is uint8 `[v, u, y, x, c]`, `GT_DEPTH` and `GT_LABELS` are `[v, u, y, x]`. The disparity
    is `dH focalLength / depth - shift`, focal length in pixels.

    The archive's cameras do not all move in the same direction. Where there is ground truth, the
    view axes are put into the order in which the views agree with it; where there is none, the
    columns are reversed, as its rendered scenes need.
    """
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise ValueError(
            f"{path} cannot be opened as an HDF5 file (truncated or of another format): {error}."
        ) from error
    with file:
        views = dataset(file, "LF", path, "[v, u, y, x, c]", 5)
        if views.dtype != np.uint8:
            raise ValueError(f"`LF` in {path} is {views.dtype}; expected uint8.")
        if views.shape[4] != 3:
            raise ValueError(
                f"`LF` in {path} has {views.shape[4]} colour channels (shape {views.shape}); "
                "expected [v, u, y, x, c] with 3."
            )
        truth = _truth_reader(file, path, views.shape[:4])
        flip_v, flip_u = (False, True) if truth is None else _view_order(views, truth())
        yield Source(
            name=path.stem,
            layout="old HCI benchmark (HDF5)",
            available=np.ones(views.shape[:2], bool),
            read=lambda row, column: views[row, column],
            label=lambda row, column: f"{path}: LF[{row}, {column}]",
            truth=truth,
            camera=_camera(file),
            flip_v=flip_v,
            flip_u=flip_u,
        )


def dataset(file: h5py.File, name: str, path: Path, axes: str, rank: int) -> h5py.Dataset:
    """The dataset `name`, checked for being there and for its number of axes."""
    found = file.get(name)
    if not isinstance(found, h5py.Dataset):
        raise ValueError(
            f"{path} holds no array `{name}` (it has: {', '.join(file) or 'nothing'}); expected "
            f"{axes}."
        )
    if found.ndim != rank:
        raise ValueError(
            f"`{name}` in {path} has {found.ndim} dimensions (shape {found.shape}); expected "
            f"{rank}, {axes}."
        )
    return found


def _attribute(file: h5py.File, name: str) -> float | None:
    value = file.attrs.get(name)
    return None if value is None else float(np.ravel(value)[0])


def _camera(file: h5py.File) -> Camera | None:
    baseline, focal, shift = (_attribute(file, name) for name in ("dH", "focalLength", "shift"))
    if baseline is None or focal is None or shift is None or baseline <= 0 or focal <= 0:
        return None
    # shift = focal * baseline / (distance of zero disparity)
    return Camera(focal, baseline, focal * baseline / shift if shift > 0 else float("inf"))


def _truth_reader(file: h5py.File, path: Path, shape: tuple[int, ...]):
    if "GT_DEPTH" not in file:
        return None
    depth = dataset(file, "GT_DEPTH", path, "[v, u, y, x]", 4)
    labels = dataset(file, "GT_LABELS", path, "[v, u, y, x]", 4) if "GT_LABELS" in file else None
    for name, array in (("GT_DEPTH", depth), ("GT_LABELS", labels)):
        if array is not None and array.shape != shape:
            raise ValueError(
                f"`{name}` in {path} has the shape {array.shape}; expected that of the views, "
                f"{shape}."
            )
    constants = {name: _attribute(file, name) for name in ("dH", "focalLength", "shift")}
    missing = [name for name, value in constants.items() if value is None]
    if missing:
        raise ValueError(
            f"{path} has `GT_DEPTH` but lacks the attribute {', '.join(missing)}; expected dH, "
            "focalLength and shift, which turn depth into disparity."
        )
    baseline, focal, shift = (float(value) for value in constants.values() if value is not None)
    centre = shape[0] // 2, shape[1] // 2

    @functools.cache  # the order of the views and the light field both need it
    def read() -> Truth:
        values = depth[:].astype(np.float32)
        check_truth(values, f"{path}: GT_DEPTH", "depth")
        known = values > 0
        if not known.any():
            raise ValueError(f"{path}: GT_DEPTH has no positive value; expected distances.")
        disparity = np.where(known, baseline * focal / np.where(known, values, 1) - shift, 0)
        disparity = disparity.astype(np.float32)
        ids = None if labels is None else labels[:].astype(np.int32)
        # Only a complete set of maps is passed on: there is no mask per view.
        return Truth(
            disparity[centre],
            known[centre],
            None if ids is None else ids[centre],
            disparity if known.all() else None,
            ids,
        )

    return read


def _view_order(views: h5py.Dataset, truth: Truth) -> tuple[bool, bool]:
    """Whether rows and columns of views must be reversed to agree with the ground truth."""
    vc, uc = views.shape[0] // 2, views.shape[1] // 2
    centre = views[vc, uc].astype(np.float32)
    flips = []
    for axis, (count, middle) in enumerate(zip(views.shape[:2], (vc, uc), strict=True)):
        if count < 3:
            flips.append(False)
            continue
        place = (middle - 1, uc) if axis == 0 else (vc, middle - 1)
        view = views[place].astype(np.float32)
        # The view before the centre sees a point at +d by the convention, at -d if reversed.
        errors = [_difference(centre, view, sign * truth.disparity, axis) for sign in (1, -1)]
        flips.append(bool(errors[1] < errors[0]))
    return flips[0], flips[1]


def _difference(centre: np.ndarray, view: np.ndarray, shift: np.ndarray, axis: int) -> float:
    y, x = np.indices(shift.shape)
    place = (y if axis == 0 else x) + np.rint(shift).astype(int)
    limit = shift.shape[axis]
    inside = (place >= 0) & (place < limit)
    place = place.clip(0, limit - 1)
    seen = view[place, x] if axis == 0 else view[y, place]
    return float(np.abs(seen - centre)[inside].mean()) if inside.any() else 0.0
