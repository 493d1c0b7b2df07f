"""What was computed, as the page takes it: from memory or from a folder."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mvedge_jax.datasets import columns_of, read_pfm
from mvedge_jax.depth import DepthResult
from mvedge_jax.lightfield import Camera, LightField
from mvedge_jax.posed import Photographs


class Result(NamedTuple):
    """A disparity map with what belongs to it; what is None is not shown.

    Attributes:
        name: what to call it.
        disparity: px per view step, larger is nearer, of the center view; not finite where unknown.
        error: its standard error, px.
        xy: edge points, `(x, y)` px in the center view.
        points: their disparity and its standard error.
        normals: their normals, unit length.
        surfaces: their surface vectors, px.
        states: maps of an optimization, first to last; `disparity` is the last.
        labels: superpixels of the center view, 0 for none.
        hidden: surfaces that the center view does not show, from `hidden_surfaces`.
        unit: of lengths, where the camera is known.
    """

    name: str
    disparity: Float[np.ndarray, "y x"]
    error: Float[np.ndarray, "y x"] | None = None
    xy: Float[np.ndarray, "n 2"] | None = None
    points: Float[np.ndarray, "n 2"] | None = None
    normals: Float[np.ndarray, "n 2"] | None = None
    surfaces: Float[np.ndarray, "n 2"] | None = None
    states: Float[np.ndarray, "k y x"] | None = None
    labels: Int[np.ndarray, "y x"] | None = None
    hidden: Float[np.ndarray, "m 7"] | None = None
    unit: str = "m"


def result_of(depth: DepthResult, *, name: str = "result") -> Result:
    """What `EdgeDepth` gives, for the page.

    Args:
        depth: the map, its error, points and surface vectors.
        name: what to call it.

    Returns:
        The same on the host, without empty slots.
    """
    points, keep = depth.points, np.asarray(depth.points.valid)
    return Result(
        name,
        np.asarray(depth.disparity),
        np.asarray(depth.error),
        np.asarray(points.xy)[keep],
        np.stack([np.asarray(points.disparity)[keep], np.asarray(points.error)[keep]], 1),
        np.asarray(points.normal)[keep],
        np.asarray(depth.surface.offset)[keep],
    )


def result_of_photograph(
    photographs: Photographs,
    index: int,
    depth: Float[np.ndarray, "y x"],
    *,
    error: Float[np.ndarray, "y x"] | None = None,
    baseline: float = 1.0,
    name: str = "result",
) -> tuple[LightField, Result]:
    """What `stereo` gives, for the page: one photograph as a light field of a single view.

    The optical axis is taken to be in the middle of the photograph, and its pixels to be square.

    Args:
        photographs: with their cameras.
        index: of the photograph whose depth it is.
        depth: along the optical axis, in the unit of the poses; shown where it is positive.
        error: its standard error, in the same unit.
        baseline: what disparity is counted by, see `Reference`.
        name: what to call it.

    Returns:
        The photograph, and its map in px per baseline.

    Raises:
        ValueError: a map is not of the size of the photograph, or `baseline` is not positive.
    """
    image, focal = photographs.images[index], float(photographs.intrinsics[index, 0, 0])
    if not (np.isfinite(baseline) and baseline > 0):
        raise ValueError(f"`baseline` must be a positive number, got {baseline}.")
    for label, values in (("depth", depth), ("error", error)):
        if values is not None and values.shape != image.shape[:2]:
            raise ValueError(
                f"`{label}` must have the size of the photograph, {image.shape[:2]}, got "
                f"{values.shape}."
            )
    known = np.isfinite(depth) & (depth > 0)
    inverse = 1 / np.where(known, depth, 1)
    disparity = np.where(known, focal * baseline * inverse, np.nan)
    spread = None if error is None else disparity * inverse * error
    camera = Camera(focal, baseline, np.inf)
    field = LightField(image[None, None], camera=camera, name=photographs.names[index])
    return field, Result(name, disparity, spread, unit="units of the model")


def hidden_surfaces(
    light_field: LightField,
    disparity: Float[np.ndarray, "v u y x"],
    error: Float[np.ndarray, "v u y x"],
    source: Int[np.ndarray, "v u y x"],
) -> Float[np.ndarray, "m 7"]:
    """Points of surfaces that only other views than the center view show.

    Args:
        light_field: the views, for their colors.
        disparity: of every view, as in `ViewDepths`, px per view step.
        error: its standard error, px.
        source: what a pixel is known from; 1 is other views only.

    Returns:
        `(x, y)` in the center view, px, disparity, its standard error, and sRGB in [0, 1], most
        certain first. Of points that fall together, to a pixel and a twentieth of one in disparity,
        the most certain one.
    """
    there = np.asarray(light_field.available)[..., None, None] & np.isfinite(disparity)
    places = np.nonzero((source == 1) & there)
    v, u, y, x = places
    vc, uc = light_field.center
    nearness, doubt = disparity[places], error[places]
    across, down = x + (u - uc) * nearness, y + (v - vc) * nearness
    cells = np.round(np.stack([across, down, 20 * nearness], axis=1)).astype(np.int64)
    order = np.argsort(doubt, kind="stable")
    _, first = np.unique(cells[order], axis=0, return_index=True)
    colors = np.asarray(light_field.views)[places]
    return np.column_stack([across, down, nearness, doubt, colors])[order[np.sort(first)]]


def read_result(folder: Path, *, name: str | None = None) -> Result:
    """Reads what `mvedge depth` or `mvedge optimize` wrote, or a lone map.

    Args:
        folder: the folder, or a disparity map (.pfm).
        name: what to call it; the folder's name by default.

    Returns:
        All that is there of it.

    Raises:
        FileNotFoundError: there is no map.
        ValueError: a file is damaged, or two of them do not fit.
    """
    folder = Path(folder)
    name = folder.stem if name is None else name
    if folder.is_file():
        return Result(name, read_pfm(folder))
    disparity = read_pfm(folder / "disparity.pfm")

    def optional(file: str) -> np.ndarray | None:
        path = folder / file
        found = read_pfm(path) if path.is_file() else None
        if found is not None and found.shape != disparity.shape:
            raise ValueError(
                f"{path} must have the size of disparity.pfm, {disparity.shape}, got {found.shape}."
            )
        return found

    before = optional("before.pfm")
    states = None if before is None else np.stack([before, disparity])
    result = Result(name, disparity, optional("standard_error.pfm"), states=states)
    points = folder / "points.npz"
    return _with_points(result, points) if points.is_file() else result


def _with_points(result: Result, path: Path) -> Result:
    with columns_of(path) as stored:
        columns = {name: column.astype(np.float32) for name, column in stored.items()}
        xy, disparity = columns["xy"], columns["disparity"]
        error = columns.get("error", np.full_like(disparity, np.nan))
        count = (len(disparity), 2)
        pairs = [columns.get(key) for key in ("normal", "surface_vector")]
        if any(pair is not None and pair.shape != count for pair in (xy, *pairs)):
            raise ValueError("its columns differ in length")
        both = np.stack([disparity, error], 1)
    return result._replace(xy=xy, points=both, normals=pairs[0], surfaces=pairs[1])
