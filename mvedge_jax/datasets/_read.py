"""Views into one array, in parallel and without a second copy."""

import os
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from jaxtyping import Float

from ._limits import check_memory
from ._source import Source

_ALIGNMENT = 64  # bytes; JAX adopts a NumPy array that is so aligned instead of copying it


def read_views(
    source: Source, rows: list[int], columns: list[int], scale: float, limit: float
) -> tuple[Float[np.ndarray, "v u y x c"], np.ndarray]:
    """Reads view by view into one array, without a second copy of the light field.

    Sizes are compared with each other and with the limit before anything is decoded.
    """
    places = [
        (i, j, row, column)
        for i, row in enumerate(rows)
        for j, column in enumerate(columns)
        if source.available[row, column]
    ]
    middle = len(rows) // 2, len(columns) // 2
    center = rows[middle[0]], columns[middle[1]]
    side = source.header(*center) if source.header else source.read(*center).shape[:2]
    if source.size is not None and side != source.size[:2]:
        height, width, file = source.size
        raise ValueError(
            f"{source.label(*center)} is {side[0]}x{side[1]} px (height x width); expected "
            f"{height}x{width}, as {file} says."
        )
    height, width = (int(length * scale + 1e-6) for length in side)
    if min(height, width) < 1:
        raise ValueError(
            f"`scale` of {scale:g} leaves no pixel of {source.label(*center)}, {side[0]}x{side[1]} "
            f"px (height x width); expected at least {1 / min(side):.3g}."
        )
    claim = f"The light field {source.label(*center)} belongs to"
    check_memory(claim, (len(rows), len(columns), height, width, 3), limit)
    check_memory(source.label(*center), (*side, 3), limit / 9)  # it is read at full size
    first = source.read(*center)
    dtype = first.dtype
    views = _aligned_zeros((len(rows), len(columns), height, width, 3))

    def fill(place: tuple[int, int, int, int]) -> None:
        i, j, row, column = place
        own = side if source.header is None else source.header(row, column)
        if own != side:
            raise differs(source.label(row, column), own, source.label(*center), side)
        image = first if (i, j) == middle else source.read(row, column)
        if image.shape != first.shape or image.dtype != dtype:
            found, wanted = (f" of {array.dtype}" for array in (image, first))
            own = image.shape[:2]
            raise differs(
                source.label(row, column), own, source.label(*center), side, found, wanted
            )
        white = np.float32(np.iinfo(dtype).max)
        if scale == 1:
            np.divide(image, white, out=views[i, j])
        else:
            views[i, j] = shrink(image.astype(np.float32), height, width, scale) / white

    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        for _ in pool.map(fill, places):
            pass
    available = np.zeros((len(rows), len(columns)), bool)
    for i, j, *_ in places:
        available[i, j] = True
    return views, available


def differs(
    file: str,
    own: tuple[int, ...],
    center: str,
    side: tuple[int, ...],
    found: str = "",
    wanted: str = "",
) -> ValueError:
    """The error for a view whose size or depth differs from the center view's."""
    return ValueError(
        f"{file} is {own[0]}x{own[1]} px (height x width){found}; expected {side[0]}x{side[1]}"
        f"{wanted}, as {center}."
    )


def _aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    size = 4 * int(np.prod(shape))
    buffer = np.zeros(size + _ALIGNMENT, np.uint8)
    start = -buffer.ctypes.data % _ALIGNMENT
    return buffer[start : start + size].view(np.float32).reshape(shape)


def shrink(image: np.ndarray, height: int, width: int, scale: float) -> np.ndarray:
    """Averages areas of `1 / scale` px; incomplete areas at the far ends are dropped."""
    rows, columns = (
        min(side, round(new / scale))
        for side, new in zip(image.shape[:2], (height, width), strict=True)
    )
    shrunk = cv2.resize(image[:rows, :columns], (width, height), interpolation=cv2.INTER_AREA)
    return shrunk.clip(0, None) if image.ndim == 3 else shrunk
