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

    def taken(self, rows: Sequence[int], columns: Sequence[int]) -> "Truth":
        """Ground truth of some rows and columns of the grid."""
        window = np.ix_(rows, columns)
        disparity, ids = (
            None if values is None else values[window]
            for values in (self.view_disparity, self.view_ids)
        )
        return dataclasses.replace(self, view_disparity=disparity, view_ids=ids)

    def exchanged(self) -> "Truth":
        """Ground truth of the grid with exchanged rows and columns."""
        disparity, ids = (
            None if values is None else values.swapaxes(0, 1)
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
        """The light field of some rows and columns of this one.

        Args:
            rows: to keep, in file order.
            columns: likewise.
            **changes: further fields of `Source`, of the whole grid.
        """
        whole = dataclasses.replace(self, **changes)
        header, truth, window = whole.header, whole.truth, np.ix_(rows, columns)
        return dataclasses.replace(
            whole,
            available=whole.available[window],
            read=lambda row, column: whole.read(rows[row], columns[column]),
            label=lambda row, column: whole.label(rows[row], columns[column]),
            header=None if header is None else lambda r, c: header(rows[r], columns[c]),
            truth=None if truth is None else lambda: truth().taken(rows, columns),
            positions=None if whole.positions is None else whole.positions[window],
        )

    def exchanged(self) -> "Source":
        """The light field with exchanged rows and columns of views."""
        header, truth = self.header, self.truth
        return dataclasses.replace(
            self,
            available=self.available.T,
            read=lambda row, column: self.read(column, row),
            label=lambda row, column: self.label(column, row),
            header=None if header is None else lambda row, column: header(column, row),
            truth=None if truth is None else lambda: truth().exchanged(),
            positions=(
                None if self.positions is None else self.positions.swapaxes(0, 1)[..., ::-1]
            ),
            flip_v=self.flip_u,
            flip_u=self.flip_v,
        )


def image_source(
    path: Path,
    layout: str,
    files: dict[tuple[int, int], Path],
    grid: tuple[int, int],
    expected: Callable[[int, int], str],
    **known,
) -> Source:
    """A source whose views are image files.

    Args:
        path: the folder.
        layout: name of the layout.
        files: file of each view (row, column) that is there.
        grid: numbers of rows and columns.
        expected: file name that view (row, column) should have, for errors.
        **known: further fields of `Source`.

    Returns:
        The source.
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
    """Refuses ground truth that is NaN or infinite.

    Args:
        values: the ground truth.
        path: the file, for the error.
        what: the quantity, for the error.

    Raises:
        ValueError: naming the file, the number of bad values and the position of the first one.
    """
    bad = ~np.isfinite(values)
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{path} holds {int(bad.sum())} values that are NaN or infinite, the first at "
            f"{place}; expected a finite {what} everywhere."
        )
