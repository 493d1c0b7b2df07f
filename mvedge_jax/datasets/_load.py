"""`load_light_field`: recognizes a layout and reads its views by the convention."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax.lightfield import Camera, GroundTruth, LightField

from ._dead import leave_out_dead_views
from ._images import picked
from ._limits import memory_limit
from ._open import open_source
from ._positions import view_positions, with_positions
from ._read import read_views, shrink
from ._source import Source, Truth


def load_light_field(
    path: str | os.PathLike,
    *,
    views: int | None = None,
    scale: float = 1.0,
    flip_u: bool = False,
    flip_v: bool = False,
    swap_axes: bool = False,
    positions: str | os.PathLike | None = None,
    disparity_range: tuple[float, float] | None = None,
    name: str | None = None,
    max_gb: float | None = None,
) -> LightField:
    """Reads a light field, whatever its layout.

    | layout | recognized by | brings along |
    |---|---|---|
    | HCI 4D benchmark | `input_CamNNN.png` | `parameters.cfg`, `gt_disp_lowres.pfm`, object ids |
    | old HCI benchmark | `.h5`, `.hdf5` with `LF` | `GT_DEPTH`, `GT_LABELS` |
    | Stanford archive | `out_RR_CC_<y>_<x>.png` | positions of the cameras |
    | Lytro, EPFL | `.mat` with `LF`, `[v, u, y, x, c]` or `[y, x, v, u, c]` | |
    | any grid | `*_RR_CC.png`, `.jpg` or `.bmp` | |

    In the first layout the ground truth may also be there for every view, as
    `gt_disp_lowres_CamNNN.pfm` and `objectids_lowres_CamNNN.png`. A folder that holds a single
    `.h5` or `.mat` file and no views stands for that file. Views outside the crosshair that are
    missing, and views that do not show the scene (`find_dead_views`, with a warning), are not
    `available`.

    **Order of views.** By the convention a point of disparity `d` moves by `(u_c - u) d` and `(v_c
    - v) d` px, and larger `d` is nearer: near points move left as `u` grows, and up as `v` grows.
    The benchmarks are read in this order. Cameras that number their views in reverse give all
    disparities the wrong sign, which shows at occlusions only. `check_convention` and `mvedge info`
    name the required flips, and exchanged rows and columns.

    **Positions.** If files give positions of cameras (the names of the Stanford archive,
    `parameters.cfg` as `write_hci` writes it, or `positions`) that deviate from a regular square
    grid by more than 2 % of a step, the light field stores and uses them. A view step is then the
    median distance of neighboring columns, unless the file defines it.

    Args:
        path: a folder or a file.
        views: keeps the central `views` x `views` (odd), of a single row or column the central
            `views`; 7 or 9 of a Lytro's, whose outer views are dark and distorted.
        scale: shrinks the views by this factor in (0, 1], averaging areas; disparities, range and
            camera shrink alike.
        flip_u: reverses the view columns, in addition to a reversal by the layout.
        flip_v: reverses the view rows in the same way.
        swap_axes: exchanges view rows and columns, before they are reversed.
        positions: a text file with a line `v u x y` per view: row and column in file order,
            counted from 0, and position to the right and down in view steps. Rows and columns
            without a line are not read.
        disparity_range: `(low, high)` in px per view step of the stored size, if missing or wrong
            in the files.
        name: name of the scene; by default that of the folder or file.
        max_gb: gigabytes that the views may take, by the headers of the files; by default the
            environment variable `MVEDGE_MAX_GB`, or 8.

    Returns:
        The light field, float32.

    Raises:
        FileNotFoundError: if there is nothing at `path`, no light field in it, or a view of the
            crosshair is missing.
        ValueError: if files are truncated, unreadable, of different sizes, contradict each other,
            do not form an odd square grid or a single odd row or column, claim more than `max_gb`,
            or hold ground truth that is not finite; if the center view does not show the scene; or
            if an option is out of range. The message names the file.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> import cv2
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for row in range(3):
        ...         for column in range(3):
        ...             file = Path(folder) / f"toy_{row}_{column}.png"
        ...             _ = cv2.imwrite(str(file), np.full((6, 8, 3), 51, np.uint8))
        ...     light_field = load_light_field(folder, name="toy")
        >>> light_field.views.shape
        (3, 3, 6, 8, 3)
    """
    if not 0 < scale <= 1:
        raise ValueError(f"`scale` must be in (0, 1], got {scale}.")
    limit = memory_limit(max_gb)
    order = {"flip_u": flip_u, "flip_v": flip_v, "swap_axes": swap_axes, "positions": positions}
    with opened(path, views=views, max_gb=max_gb, **order) as (source, rows, columns):
        images, available = read_views(source, rows, columns, scale, limit)
        leave_out_dead_views(images, available, source, rows, columns)
        truth = None
        if source.truth is not None:
            truth = _ground_truth(source, source.truth(), rows, columns, scale, images.shape[2:4])
        limits = source.disparity_range if disparity_range is None else disparity_range
        camera = source.camera
        if camera is not None:
            camera = Camera(camera.focal_px * scale, camera.baseline, camera.focus_distance)
        return LightField(
            jax.device_put(images),
            available=available,
            positions=view_positions(source, rows, columns),
            disparity_range=None if limits is None else tuple(scale * end for end in limits),
            truth=truth,
            camera=camera,
            name=source.name if name is None else name,
        )


@contextmanager
def opened(
    path: str | os.PathLike,
    *,
    views: int | None = None,
    flip_u: bool = False,
    flip_v: bool = False,
    swap_axes: bool = False,
    positions: str | os.PathLike | None = None,
    max_gb: float | None = None,
) -> Iterator[tuple[Source, list[int], list[int]]]:
    """A light field, and the rows and columns to read of it in the order of the convention."""
    with open_source(Path(path), max_gb=max_gb) as source:
        placed = source if positions is None else with_positions(source, Path(positions))
        turned = placed.exchanged() if swap_axes else placed
        yield turned, *_places_of(turned, views, flip_u, flip_v)


def load_ground_truth(path: str | os.PathLike) -> GroundTruth:
    """Reads the ground truth of a light field, and of its views only the center view.

    Args:
        path: a folder or a file, as for `load_light_field`.

    Returns:
        The ground truth at full size, views in the order of the convention.

    Raises:
        FileNotFoundError: if there is no light field at `path`, or no center view.
        ValueError: if it comes without ground truth, or the ground truth cannot be read, is not
            finite, or is not of the center view's size.
    """
    with open_source(Path(path)) as source:
        if source.truth is None:
            raise ValueError(
                f"{path} ({source.layout}) has no ground truth; expected gt_disp_lowres.pfm beside "
                "the views, or GT_DEPTH in an HDF5 file."
            )
        rows, columns = (list(range(count)) for count in source.available.shape)
        center = rows[len(rows) // 2], columns[len(columns) // 2]
        if not source.available[center]:
            raise FileNotFoundError(f"{source.label(*center)}, the center view, is missing.")
        if source.flip_v:
            rows.reverse()
        if source.flip_u:
            columns.reverse()
        return _ground_truth(source, source.truth(), rows, columns, 1.0, _size(source, *center))


def _places_of(
    source: Source, views: int | None, flip_u: bool, flip_v: bool
) -> tuple[list[int], list[int]]:
    """The rows and columns of the file order to read, in the order of the convention."""
    rows, columns = source.available.shape
    where = source.label(0, 0) if rows * columns == 1 else f"{source.name} ({source.layout})"
    # For a single row or column, the other side decides.
    single = min(rows, columns) == 1
    most = max(rows, columns) if single else min(rows, columns)
    if views is None:
        if not (single or rows == columns) or most % 2 == 0 or most < 3:
            advice = f"; views={most - (most % 2 == 0)} keeps the central ones" if most >= 3 else ""
            raise ValueError(
                f"{where} has a grid of {rows}x{columns} views (rows x columns); expected an odd "
                f"square of 3x3 or more, or an odd row or column of three or more{advice}."
            )
        views = most
    elif views % 2 == 0 or views < 3 or views > most:
        raise ValueError(
            f"`views` must be odd, at least 3 and at most the grid of {rows}x{columns} views of "
            f"{where}, got {views}."
        )
    counts = min(views, rows), min(views, columns)
    flips = source.flip_v != flip_v, source.flip_u != flip_u
    kept = []
    for size, count, flip in zip((rows, columns), counts, flips, strict=True):
        first = size // 2 - count // 2
        kept.append(list(range(first, first + count))[:: -1 if flip else 1])
    missing = [
        (row, column)
        for i, row in enumerate(kept[0])
        for j, column in enumerate(kept[1])
        if (i == counts[0] // 2 or j == counts[1] // 2) and not source.available[row, column]
    ]
    if missing:
        row, column = min(missing)
        raise FileNotFoundError(
            f"{source.label(row, column)} is missing (row {row}, column {column} of a grid of "
            f"{rows}x{columns} views); expected at least the crosshair, the whole center row and "
            f"column, of which {len(missing)} of {sum(counts) - 1} are missing."
        )
    return kept[0], kept[1]


def _ground_truth(
    source: Source,
    truth: Truth,
    rows: list[int],
    columns: list[int],
    scale: float,
    size: tuple[int, int],
) -> GroundTruth:
    """Ground truth of the views that were kept, at their scale."""
    center = rows[len(rows) // 2], columns[len(columns) // 2]
    stored = _size(source, *center)
    if truth.disparity.shape != stored:
        raise ValueError(
            f"The ground truth of {source.name} is {truth.disparity.shape[0]}x"
            f"{truth.disparity.shape[1]} px (height x width); expected {stored[0]}x{stored[1]}, as "
            f"{source.label(*center)}."
        )
    window = np.ix_(rows, columns)
    if scale == 1:
        return GroundTruth(
            jnp.asarray(truth.disparity),
            jnp.asarray(truth.valid),
            _optional(truth.object_ids),
            _optional(None if truth.view_disparity is None else truth.view_disparity[window]),
            _optional(None if truth.view_ids is None else truth.view_ids[window]),
        )

    def mean(values: np.ndarray) -> np.ndarray:
        return shrink(values.astype(np.float32), *size, scale)

    def pick(values: np.ndarray) -> np.ndarray:
        return picked(values, size, (scale, scale))

    def every(values: np.ndarray | None, one) -> np.ndarray | None:
        if values is None:
            return None
        return np.stack([[one(values[row, column]) for column in columns] for row in rows])

    valid = mean(truth.valid) > 1 - 1e-4
    view_disparity = every(truth.view_disparity, mean)
    return GroundTruth(
        jnp.asarray(np.where(valid, mean(truth.disparity) * np.float32(scale), np.float32(0))),
        jnp.asarray(valid),
        _optional(None if truth.object_ids is None else pick(truth.object_ids)),
        _optional(None if view_disparity is None else view_disparity * np.float32(scale)),
        _optional(every(truth.view_ids, pick)),
    )


def _size(source: Source, row: int, column: int) -> tuple[int, int]:
    """Height and width of a view, as stored."""
    if source.header is not None:
        return source.header(row, column)
    height, width = source.read(row, column).shape[:2]
    return height, width


def _optional(values: np.ndarray | None):
    return None if values is None else jnp.asarray(values)
