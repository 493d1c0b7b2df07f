"""Positions of views, from a source or a file, in view steps from the center view."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvedge_jax._positions import check_positions

from ._limits import read_text
from ._source import Source

# Largest deviation from a regular square grid, view steps, that is ignored.
_REGULAR = 0.02


def with_positions(source: Source, path: Path) -> Source:
    """Applies a file of positions to a source and keeps the rows and columns that it names.

    The file has a line `v u x y` for every view: row and column in file order, then the position to
    the right and down, in view steps; `#` begins a comment. Malformed lines, views that are not in
    the grid or named twice, and a center view whose ground truth is unknown are ValueErrors.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path} is not there; expected a text file of positions.")
    grid, named = source.available.shape, {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        fields = line.split("#", 1)[0].split()
        if not fields:
            continue
        try:
            v, u, x, y = (float(field) for field in fields)
        except ValueError:
            v = u = x = y = math.nan
        if not all(map(math.isfinite, (v, u, x, y))):
            raise ValueError(
                f"{path} says {line.strip()[:60]!r} in line {number}; expected four numbers "
                "`v u x y`: row and column of a view, its position to the right and down."
            )
        place = int(v), int(u)
        if place != (v, u) or not (0 <= v < grid[0] and 0 <= u < grid[1]):
            raise ValueError(
                f"{path} names view (v, u) = ({v:g}, {u:g}) in line {number}; expected one of the "
                f"grid of {grid[0]}x{grid[1]} views of {source.name}, counted from 0."
            )
        if place in named:
            raise ValueError(f"{path} names view (v, u) = {place} twice; expected it once.")
        named[place] = x, y
    if not named:
        raise ValueError(f"{path} names no view; expected a line `v u x y` for every view.")
    positions = np.full((*grid, 2), np.nan)
    for place, position in named.items():
        positions[place] = position
    rows, columns = (sorted({place[axis] for place in named}) for axis in (0, 1))
    left = rows[len(rows) // 2], columns[len(columns) // 2]
    if source.truth is not None and left != (grid[0] // 2, grid[1] // 2):
        raise ValueError(
            f"{path} leaves {len(rows)}x{len(columns)} views, of which {source.label(*left)} is in "
            f"the middle; expected {source.label(grid[0] // 2, grid[1] // 2)}, whose ground truth "
            "is known."
        )
    return source.taken(rows, columns, positions=positions, in_steps=True)


def view_positions(
    source: Source, rows: list[int], columns: list[int]
) -> Float[np.ndarray, "v u 2"] | None:
    """Positions of the views that are read, as `LightField` has them.

    View steps from the center view; None if unknown, or regular to 2 % of a step. Positions in
    another unit are divided by the median distance of neighboring columns (for a single column,
    rows). Signs follow the order of the views: columns increase to the right, rows down. Positions
    may be NaN where a view is missing; those that do not form rows and columns are a ValueError.
    """
    if source.positions is None:
        return None
    places = source.positions[np.ix_(rows, columns)].astype(float)
    where = f"{source.name} ({source.layout})"
    if np.isinf(places).any():
        raise ValueError(
            f"{where} has views that are infinitely far away; expected finite numbers."
        )
    for number, axis in ((0, 0), (1, 1)):
        # The crosshair is complete: a missing view is in a column and a row of others.
        known = places[..., number]
        whole = np.broadcast_to(np.nanmedian(known, axis=axis, keepdims=True), known.shape)
        places[..., number] = np.where(np.isnan(known), whole, known)
    places -= places[len(rows) // 2, len(columns) // 2].copy()
    if not source.in_steps:
        steps = [
            np.median(np.diff(places[..., number], axis=1 - number)) if count > 1 else 0.0
            for number, count in ((0, len(columns)), (1, len(rows)))
        ]
        unit = abs(steps[0] if len(columns) > 1 else steps[1])
        if unit == 0:
            raise ValueError(
                f"{where} has neighboring views at the same position; expected positions that "
                "increase or decrease from view to view."
            )
        places = places * np.where(np.array(steps) < 0, -1, 1) / unit
    if _regular(places, in_steps=source.in_steps):
        return None
    try:
        check_positions(places)
    except ValueError as reason:
        raise ValueError(f"Positions of the views of {where} do not fit: {reason}") from None
    return places


def _regular(places: Float[np.ndarray, "v u 2"], *, in_steps: bool) -> bool:
    """Whether views are on a square grid, of the spacing that fits best if it is not given."""
    v, u = np.indices(places.shape[:2])
    grid = np.stack([u - places.shape[1] // 2, v - places.shape[0] // 2], axis=-1)
    spacing = 1.0 if in_steps else float((places * grid).sum() / max((grid * grid).sum(), 1))
    return spacing > 0 and bool((np.abs(places / spacing - grid) <= _REGULAR).all())
