"""Folders of images whose names end in a row and a column: `*_RR_CC.png`."""

import re
from pathlib import Path

from ._limits import check_grid, some
from ._source import Source, image_source

_VIEW = re.compile(
    r"(?P<prefix>.*?)(?P<row>\d+)[_-](?P<column>\d+)\.(?P<suffix>png|jpg|jpeg|bmp)", re.IGNORECASE
)


def is_grid(names: list[str]) -> bool:
    """Whether a folder with these file names looks like a grid of images."""
    return any(_VIEW.fullmatch(name) for name in names)


def open_grid(path: Path, names: list[str]) -> Source:
    """Opens a folder of `*_RR_CC.png|jpg|bmp`: any first index, zero-padded or not."""
    groups: dict[tuple[str, str], dict[tuple[int, int], str]] = {}
    for name in sorted(names):
        match = _VIEW.fullmatch(name)
        if match is None:
            continue
        group = groups.setdefault((match["prefix"], match["suffix"]), {})
        place = int(match["row"]), int(match["column"])
        if place in group:
            raise ValueError(
                f"{path / name} and {path / group[place]} are both row {place[0]}, column "
                f"{place[1]}; expected one image per view."
            )
        group[place] = name
    if len(groups) > 1:
        kinds = some(f"'{prefix}RR_CC.{suffix}'" for prefix, suffix in groups)
        raise ValueError(
            f"{path} holds several grids of images ({kinds}); expected one per folder."
        )
    ((prefix, suffix), named), *_ = groups.items()
    first_row, last_row = min(r for r, _ in named), max(r for r, _ in named)
    first_column, last_column = min(c for _, c in named), max(c for _, c in named)
    grid = (last_row - first_row + 1, last_column - first_column + 1)
    check_grid(path, *grid)
    files = {(r - first_row, c - first_column): path / name for (r, c), name in named.items()}
    sample = next(match for name in named.values() if (match := _VIEW.fullmatch(name)))
    digits = [len(sample[key]) if sample[key].startswith("0") else 1 for key in ("row", "column")]
    between = sample[0][sample.end("row") : sample.start("column")]

    def expected(row: int, column: int) -> str:
        return (
            f"{prefix}{row + first_row:0{digits[0]}d}{between}"
            f"{column + first_column:0{digits[1]}d}.{suffix}"
        )

    return image_source(path, "grid of images", files, grid, expected)
