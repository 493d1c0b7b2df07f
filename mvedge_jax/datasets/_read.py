"""Views into one array, in parallel and without a second copy."""

import os
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from jaxtyping import Float

from ._source import Source

_ALIGNMENT = 64  # bytes; JAX adopts a NumPy array that is so aligned instead of copying it


def read_views(
    source: Source, rows: list[int], columns: list[int], scale: float
) -> tuple[Float[np.ndarray, "v u y x c"], np.ndarray]:
    """Reads view by view into one array: no second copy of a light field at any time."""
    places = [
        (i, j, row, column)
        for i, row in enumerate(rows)
        for j, column in enumerate(columns)
        if source.available[row, column]
    ]
    middle = len(rows) // 2, len(columns) // 2
    centre = rows[middle[0]], columns[middle[1]]
    first = source.read(*centre)
    shape, dtype = first.shape, first.dtype
    if source.size is not None and shape[:2] != source.size[:2]:
        height, width, file = source.size
        raise ValueError(
            f"{source.label(*centre)} is {shape[0]}x{shape[1]} px (height x width); expected "
            f"{height}x{width}, as {file} says."
        )
    height, width = (max(1, int(side * scale + 1e-6)) for side in shape[:2])
    views = _aligned_zeros((len(rows), len(columns), height, width, 3))

    def fill(place: tuple[int, int, int, int]) -> None:
        i, j, row, column = place
        image = first if (i, j) == middle else source.read(row, column)
        if image.shape != shape or image.dtype != dtype:
            raise ValueError(
                f"{source.label(row, column)} is {image.shape[0]}x{image.shape[1]} px (height x "
                f"width) of {image.dtype}; expected {shape[0]}x{shape[1]} of {dtype}, as "
                f"{source.label(*centre)}."
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


def _aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    size = 4 * int(np.prod(shape))
    buffer = np.zeros(size + _ALIGNMENT, np.uint8)
    start = -buffer.ctypes.data % _ALIGNMENT
    return buffer[start : start + size].view(np.float32).reshape(shape)


def shrink(image: np.ndarray, height: int, width: int, scale: float) -> np.ndarray:
    """Averages areas of `1 / scale` px; what does not fill an area at the far ends is dropped."""
    rows, columns = (
        min(side, round(new / scale))
        for side, new in zip(image.shape[:2], (height, width), strict=True)
    )
    shrunk = cv2.resize(image[:rows, :columns], (width, height), interpolation=cv2.INTER_AREA)
    return shrunk.clip(0, None) if image.ndim == 3 else shrunk
