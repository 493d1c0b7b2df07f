"""The common form of all layouts: a grid of views to read, with optional metadata."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mvedge_jax.lightfield import Camera

from ._images import image_size, read_image
from ._limits import plain_name


@dataclasses.dataclass(frozen=True)
class Truth:
    """Ground truth of the grid as stored, NumPy; see `mvedge_jax.GroundTruth`."""

    disparity: Float[np.ndarray, "y x"]
    valid: Bool[np.ndarray, "y x"]
    object_ids: Int[np.ndarray, "y x"] | None = None
    view_disparity: Float[np.ndarray, "v u y x"] | None = None
    view_ids: Int[np.ndarray, "v u y x"] | None = None

    def regridded(self, change: Callable[[np.ndarray], np.ndarray]) -> "Truth":
        """Ground truth of another grid, after a change of maps `[v, u, ...]`."""
        disparity, ids = (
            None if values is None else change(values)
            for values in (self.view_disparity, self.view_ids)
        )
        return dataclasses.replace(self, view_disparity=disparity, view_ids=ids)


@dataclasses.dataclass(frozen=True)
class Source:
    """A light field on disk, opened but not read.

    Attributes:
        name: name of the scene.
        layout: the recognized layout, for messages.
        available: which views are stored, in file order.
        read: gives view (row, column) of the file order as uint8 or uint16 RGB.
        label: name of view (row, column) in errors: its file or index.
        truth: reads the ground truth; None if there is none.
        camera: the geometry if known.
        disparity_range: px per view step if known.
        flip_v: whether rows have to be reversed to meet the convention.
        flip_u: whether columns have to be reversed.
        size: `(height, width)` in the metadata, if any, and its file.
        header: gives height and width of view (row, column) from its header, without reading it;
            None if `read` is as cheap.
        positions: `(x, y)` of every camera, NaN where it is missing; None if not known.
        in_steps: whether positions are in view steps, x to the right and y down; else in another
            unit.
    """

    name: str
    layout: str
    available: Bool[np.ndarray, "v u"]
    read: Callable[[int, int], np.ndarray]
    label: Callable[[int, int], str]
    truth: Callable[[], Truth] | None = None
    camera: Camera | None = None
    disparity_range: tuple[float, float] | None = None
    flip_v: bool = False
    flip_u: bool = False
    size: tuple[int, int, str] | None = None
    header: Callable[[int, int], tuple[int, int]] | None = None
    positions: Float[np.ndarray, "v u 2"] | None = None
    in_steps: bool = False

    def taken(self, rows: Sequence[int], columns: Sequence[int], **changes: Any) -> "Source":
        """The light field of some rows and columns of this one, after `changes` of whole fields."""
        whole, window = dataclasses.replace(self, **changes), np.ix_(rows, columns)
        return whole._regridded(
            lambda row, column: (rows[row], columns[column]), lambda values: values[window]
        )

    def exchanged(self) -> "Source":
        """The light field with exchanged rows and columns of views."""
        turned = self._regridded(
            lambda row, column: (column, row), lambda values: values.swapaxes(0, 1)
        )
        return dataclasses.replace(
            turned,
            positions=None if turned.positions is None else turned.positions[..., ::-1],
            flip_v=self.flip_u,
            flip_u=self.flip_v,
        )

    def _regridded(
        self,
        places: Callable[[int, int], tuple[int, int]],
        change: Callable[[np.ndarray], np.ndarray],
    ) -> "Source":
        """The light field of another grid: where its views are in this one, and arrays of views."""
        header, truth = self.header, self.truth
        return dataclasses.replace(
            self,
            available=change(self.available),
            read=lambda row, column: self.read(*places(row, column)),
            label=lambda row, column: self.label(*places(row, column)),
            header=None if header is None else lambda row, column: header(*places(row, column)),
            truth=None if truth is None else lambda: truth().regridded(change),
            positions=None if self.positions is None else change(self.positions),
        )


def image_source(
    path: Path,
    layout: str,
    files: dict[tuple[int, int], Path],
    grid: tuple[int, int],
    expected: Callable[[int, int], str],
    **known,
) -> Source:
    """A source whose views are image files, by row and column.

    `expected` names the file that a view should have, for errors; `known` are further fields.
    """
    available = np.zeros(grid, bool)
    for place in files:
        available[place] = True

    def label(row: int, column: int) -> str:
        file = files.get((row, column))
        return str(file if file is not None else path / expected(row, column))

    return Source(
        name=plain_name(path.resolve()),
        layout=layout,
        available=available,
        read=lambda row, column: read_image(files[row, column]),
        label=label,
        header=lambda row, column: image_size(files[row, column]),
        **known,
    )


def check_truth(values: np.ndarray, path: Path | str, what: str = "disparity") -> None:
    """Refuses ground truth that is NaN or infinite, and names the first such place."""
    bad = ~np.isfinite(values)
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{path} holds {int(bad.sum())} values that are NaN or infinite, the first at "
            f"{place}; expected a finite {what} everywhere."
        )
