"""The (New) Stanford light field archive: `out_RR_CC_<y>_<x>.png`, camera positions in the name."""

import re
from pathlib import Path

import numpy as np

from ._limits import check_grid
from ._source import Source, image_source

_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_VIEW = re.compile(
    rf"(?P<prefix>.*?)(?P<row>\d+)_(?P<column>\d+)_(?P<y>{_NUMBER})_(?P<x>{_NUMBER})_?"
    r"\.(?P<suffix>png|jpg|jpeg|bmp)",
    re.IGNORECASE,
)


def is_stanford(names: list[str]) -> bool:
    """Whether a folder with these file names is in the archive's layout."""
    return any(_VIEW.fullmatch(name) for name in names)


def open_stanford(path: Path, names: list[str]) -> Source:
    """Opens a rectified light field of the Stanford archive.

    Rows and columns without any file are dropped; the names give the positions of the others.
    """
    entries: dict[tuple[int, int], re.Match] = {}
    for match in filter(None, map(_VIEW.fullmatch, sorted(names))):
        place = int(match["row"]), int(match["column"])
        if place in entries:
            raise ValueError(
                f"{path / match[0]} and {path / entries[place][0]} are both row {place[0]}, column "
                f"{place[1]}; expected one image per view."
            )
        entries[place] = match
    check_grid(path, *(max(place[axis] for place in entries) + 1 for axis in (0, 1)))
    rows, columns = (sorted({place[axis] for place in entries}) for axis in (0, 1))
    grid = len(rows), len(columns)
    files, positions = {}, np.full((*grid, 2), np.nan)
    for (row, column), match in entries.items():
        place = rows.index(row), columns.index(column)
        files[place], positions[place] = path / match[0], (float(match["x"]), float(match["y"]))
    return image_source(
        path,
        "Stanford archive",
        files,
        grid,
        lambda row, column: f"out_{rows[row]:02d}_{columns[column]:02d}_<y>_<x>.png",
        positions=positions,
    )
