"""The crosshair of large light fields, in the bits of their files."""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from mvedge_jax._stored_views import StoredViews

from ._dead import leave_out_dead_views
from ._limits import check_memory, memory_limit
from ._load import opened
from ._positions import view_positions
from ._read import differs
from ._source import Source

# Dead views show in pictures of this size.
_SMALL = 256


def load_stored_views(
    path: str | os.PathLike,
    *,
    disparity_range: tuple[float, float] | None = None,
    name: str | None = None,
    max_gb: float | None = None,
    **order: Any,
) -> StoredViews:
    """Reads the center row and the center column of views, for depth in tiles.

    Args:
        path: a folder or a file, of any layout that `load_light_field` reads.
        disparity_range: `(low, high)` in px per view step.
        name: what to call the scene.
        max_gb: gigabytes that the views may take, in the bits of their files.
        **order: `views`, `flip_u`, `flip_v`, `swap_axes` and `positions` of `load_light_field`.

    Returns:
        The views in 8 or 16 bits, in the order of the convention. Errors and warnings are those of
        `load_light_field`.
    """
    limit = memory_limit(max_gb)
    with opened(path, max_gb=max_gb, **order) as (source, rows, columns):
        planes = _read(source, rows, columns, limit)
        _leave_out_dead(planes, source, rows, columns)
        return StoredViews(
            planes,
            (len(rows), len(columns)),
            view_positions(source, rows, columns),
            source.disparity_range if disparity_range is None else disparity_range,
            source.camera,
            source.name if name is None else name,
        )


def _read(
    source: Source, rows: list[int], columns: list[int], limit: float
) -> dict[tuple[int, int], np.ndarray]:
    """The views of the crosshair that are there, by their places."""
    vc, uc = len(rows) // 2, len(columns) // 2
    cross = [(vc, u) for u in range(len(columns))] + [(v, uc) for v in range(len(rows)) if v != vc]
    places = [(v, u) for v, u in cross if source.available[rows[v], columns[u]]]
    center = source.read(rows[vc], columns[uc])
    label = source.label(rows[vc], columns[uc])
    claim = f"The crosshair of the light field that {label} belongs to"
    check_memory(claim, (len(places), *center.shape), limit, size=center.itemsize)

    def read(place: tuple[int, int]) -> np.ndarray:
        row, column = rows[place[0]], columns[place[1]]
        image = source.read(row, column)
        if image.shape != center.shape or image.dtype != center.dtype:
            kinds = (f" of {array.dtype}" for array in (image, center))
            own = source.label(row, column)
            raise differs(own, image.shape[:2], label, center.shape[:2], *kinds)
        return image

    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        return dict(zip(places, pool.map(read, places), strict=True))


def _leave_out_dead(
    planes: dict[tuple[int, int], np.ndarray], source: Source, rows: list[int], columns: list[int]
) -> None:
    """Drops views that do not show the scene, which small pictures tell."""
    one = next(iter(planes.values()))
    step = max(1, min(one.shape[:2]) // _SMALL)
    small = one[::step, ::step]
    views: Any = np.zeros((len(rows), len(columns), *small.shape), np.float32)
    available = np.zeros(views.shape[:2], bool)
    for place, plane in planes.items():
        views[place], available[place] = plane[::step, ::step] / np.iinfo(plane.dtype).max, True
    leave_out_dead_views(views, available, source, rows, columns)
    for place in [place for place in planes if not available[place]]:
        del planes[place]
