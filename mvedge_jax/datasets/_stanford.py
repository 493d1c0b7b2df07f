"""The (New) Stanford light field archive: `out_RR_CC_<y>_<x>.png`, camera positions in the name."""

import dataclasses
import os
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ._limits import check_grid
from ._source import Source, image_source

_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_VIEW = re.compile(
    rf"(?P<prefix>.*?)(?P<row>\d+)_(?P<column>\d+)_(?P<y>{_NUMBER})_(?P<x>{_NUMBER})_?"
    r"\.(?P<suffix>png|jpg|jpeg|bmp)",
    re.IGNORECASE,
)


@dataclasses.dataclass(frozen=True)
class CameraSpacing:
    """How evenly the cameras of a rig are spaced.

    Attributes:
        positions: `(x, y)` of each camera in the archive's unit, NaN where it is missing.
        step: mean step from one view column (row) to the next along x (y), same unit, signed.
        deviation: largest distance of a camera from its position on the best-fitting regular grid,
            in steps. Times a point's disparity, it is the largest error of the point's position in
            a view, px.
    """

    positions: Float[np.ndarray, "v u 2"]
    step: tuple[float, float]
    deviation: float


def is_stanford(names: list[str]) -> bool:
    """Whether a folder with these file names is in the archive's layout."""
    return any(_match(name) for name in names)


def open_stanford(path: Path, names: list[str]) -> Source:
    """Opens a rectified light field of the Stanford archive.

    Rows and columns without any file are dropped; the names give the positions of the others.
    """
    entries = _entries(path, names)
    check_grid(path, *(max(place[axis] for place in entries) + 1 for axis in (0, 1)))
    rows, columns = (sorted({place[axis] for place in entries}) for axis in (0, 1))
    grid = len(rows), len(columns)
    files, positions = {}, np.full((*grid, 2), np.nan)
    for (row, column), (name, position) in entries.items():
        place = rows.index(row), columns.index(column)
        files[place], positions[place] = path / name, position
    return image_source(
        path,
        "Stanford archive",
        files,
        grid,
        lambda row, column: f"out_{rows[row]:02d}_{columns[column]:02d}_<y>_<x>.png",
        positions=positions,
    )


def camera_spacing(path: str | os.PathLike) -> CameraSpacing:
    """Reads the camera positions from the file names of a Stanford light field.

    Args:
        path: a folder with `out_RR_CC_<y>_<x>.png`.

    Returns:
        The positions and how far they are from a regular grid. Positions are in file order.

    Raises:
        FileNotFoundError: if there is no such folder.
        ValueError: if it holds no such files, or fewer than two rows or columns of them.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is not there; expected a folder of views.")
    names = [file.name for file in folder.iterdir()]
    if not is_stanford(names):
        raise ValueError(f"{folder} holds no out_RR_CC_<y>_<x>.png; camera positions are unknown.")
    entries = _entries(folder, names)
    rows, columns = (max(place[axis] for place in entries) + 1 for axis in (0, 1))
    check_grid(folder, rows, columns)
    if rows < 2 or columns < 2:
        raise ValueError(
            f"{folder} holds {rows}x{columns} views; expected two rows and columns or more to "
            "measure their spacing."
        )
    positions = np.full((rows, columns, 2), np.nan)
    for place, (_, position) in entries.items():
        positions[place] = position
    row, column = np.array(list(entries)).T
    found = positions[row, column]
    # x and y each as an affine function of row and column: a rig may also be rotated or sheared.
    basis = np.stack([np.ones(len(row)), column, row], axis=1).astype(float)
    fit = np.linalg.lstsq(basis, found, rcond=None)[0]
    step_x, step_y = float(fit[1, 0]), float(fit[2, 1])
    unit = min(abs(step_x), abs(step_y))
    farthest = float(np.linalg.norm(found - basis @ fit, axis=1).max())
    return CameraSpacing(positions, (step_x, step_y), farthest / unit if unit > 0 else float("inf"))


def _match(name: str) -> re.Match | None:
    return _VIEW.fullmatch(name)


def _entries(path: Path, names: list[str]) -> dict[tuple[int, int], tuple[str, tuple]]:
    entries: dict[tuple[int, int], tuple[str, tuple]] = {}
    for name in sorted(names):
        match = _match(name)
        if match is None:
            continue
        place = int(match["row"]), int(match["column"])
        if place in entries:
            raise ValueError(
                f"{path / name} and {path / entries[place][0]} are both row {place[0]}, column "
                f"{place[1]}; expected one image per view."
            )
        entries[place] = name, (float(match["x"]), float(match["y"]))
    return entries
