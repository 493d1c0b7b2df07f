"""Edge points as files: .npz for programs, CSV for spreadsheets."""

from pathlib import Path

import jax
import numpy as np

from mvedge_jax.edges import EdgePoints

_COLUMNS = "x,y,disparity,confidence,standard_error,normal_x,normal_y,views"
_FORMATS = ("%.3f", "%.3f", "%.5f", "%.5f", "%.2e", "%.4f", "%.4f", "%d")


def valid_points(points: EdgePoints) -> EdgePoints:
    """The points without empty slots, on the host."""
    keep = np.asarray(points.valid)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[keep], points)


def write_points(folder: Path, points: EdgePoints, *, surface: np.ndarray | None = None) -> None:
    """Writes `points.npz` and `points.csv` of `valid_points`, with surface vectors if given."""
    fields = {name: value for name, value in vars(points).items() if name != "valid"}
    names = ("xy", "disparity", "confidence", "error", "normal")
    columns = [np.asarray(fields[name]) for name in names]
    columns.append(np.asarray(points.visible).sum(1))
    header, formats = _COLUMNS, list(_FORMATS)
    if surface is not None:
        fields["surface_vector"] = surface
        columns.append(surface)
        header += ",surface_x,surface_y"
        formats += ["%.4f", "%.4f"]
    np.savez_compressed(folder / "points.npz", **fields)
    table = np.column_stack(columns)
    path = folder / "points.csv"
    np.savetxt(path, table, fmt=formats, delimiter=",", header=header, comments="")
