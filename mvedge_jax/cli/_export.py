"""`mvedge export`: views, cameras, points and depth for other tools."""

from pathlib import Path
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
import tyro

from mvedge_jax.datasets.exchange import from_origin, write_colmap, write_nerfstudio, write_ply
from mvedge_jax.posed import Photographs
from mvedge_jax.posed.cloud import Surface, surface_of

from ._common import note, stage
from ._gathered import Gathered, gather
from ._output import output_folder, write_json
from ._paths import stems_of


def export(
    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|RESULT")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    to: Literal["ply", "colmap", "nerfstudio"],
    points: Literal["dense", "edges"] = "dense",
    camera: tuple[float, float, float] | None = None,
    overwrite: bool = False,
) -> None:
    """Writes views, cameras, points and depth in the formats of other tools.

    OUT gets, for ply: NAME.ply for every view with depth, colored points with normals and standard
    errors; for colmap: images and sparse/0, a model in text form, with the edge points; for
    nerfstudio: images, transforms.json, depth maps and masks. The unit is that of the cameras,
        meters for light fields; the world is the center view's camera.

    Args:
        source: a light field (cameras and views only), or a result of mvedge depth, views or
            stereo (with its depth).
        out: folder to write.
        to: the format.
        points: for ply: every pixel, or the edge points of mvedge depth.
        camera: focal length in px, baseline and focus distance, for a light field without a known
            camera.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
    """
    with stage(f"reading {source}"):
        found = gather(source, camera)
    if to == "ply" and points == "dense" and not found.depth:
        raise ValueError(
            f"{source} has no depth to make points of; run mvedge depth, views or stereo, and "
            "export what it wrote."
        )
    report: dict[str, Any] = {"source": str(source.resolve()), "form": to}
    with output_folder(out, inputs=[source], overwrite=overwrite) as folder, stage("writing"):
        if to == "colmap":
            write_colmap(folder, found.photographs)
        elif to == "nerfstudio":
            write_nerfstudio(folder, found.photographs, depth=found.depth)
        elif points == "edges":
            report["points"] = _edges(folder, found, source)
        else:
            report["points"] = _dense(folder, found)
        write_json(folder / "report.json", report)
    note(f"{_written(found, report)}; written to {out}")


def _written(found: Gathered, report: dict[str, Any]) -> str:
    """Contents of the folder, in words."""
    counts = report.get("points")
    if counts is not None:
        clouds = "1 point cloud" if len(counts) == 1 else f"{len(counts)} point clouds"
        return f"{clouds} ({_files(counts)}), {sum(counts.values())} points"
    views, points = found.photographs.names, found.photographs.points
    text = f"{len(views)} views with their cameras, {0 if points is None else len(points)} points"
    return text + f", depth of {len(found.depth)}" if report["form"] == "nerfstudio" else text


def _files(counts: dict[str, int]) -> str:
    names = [f"{stem}.ply" for stem in counts]
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")


def _surface(views: Photographs, index: int, depth: np.ndarray) -> tuple[Surface, np.ndarray]:
    """The surface that a photograph shows, and its colors."""
    pose = views.poses[index]
    surface = surface_of(jnp.asarray(depth, pose.dtype), pose, views.intrinsics[index])
    return surface, np.round(255 * np.asarray(views.images[index])).astype(np.uint8)


def _dense(folder: Path, found: Gathered) -> dict[str, int]:
    """Writes a cloud of every view with depth; returns their numbers of points."""
    counts, views = {}, found.photographs
    stems = stems_of(views.names)
    for index, depth in found.depth.items():
        surface, colors = _surface(views, index, depth)
        keep = np.isfinite(depth) & (depth > 0)
        stem, error = stems[views.names[index]], found.error.get(index)
        write_ply(
            folder / f"{stem}.ply",
            from_origin(np.asarray(surface.points)[keep], views.origin),
            colors=colors[keep],
            normals=np.asarray(surface.normals)[keep],
            error=None if error is None else error[keep],
        )
        counts[stem] = int(keep.sum())
    return counts


def _edges(folder: Path, found: Gathered, source: Path) -> dict[str, int]:
    """The edge points, with colors and normals of the view in which they were found."""
    views = found.photographs
    # Points of a stereo result are COLMAP's, not those of one photograph.
    if views.points is None or found.point_error is None or not len(views.points):
        raise ValueError(
            f"{source} has no edge points; run mvedge depth, and export what it wrote."
        )
    index, depth = next(iter(found.depth.items()))
    row, column = _pixels(views, index)
    surface, colors = _surface(views, index, depth)
    write_ply(
        folder / "edges.ply",
        from_origin(np.asarray(views.points), views.origin),
        colors=colors[row, column],
        normals=np.asarray(surface.normals)[row, column],
        error=found.point_error,
    )
    return {"edges": len(views.points)}


def _pixels(views: Photographs, index: int) -> tuple[np.ndarray, np.ndarray]:
    """The pixels of a photograph that contain its points."""
    pose, matrix = np.asarray(views.poses[index]), np.asarray(views.intrinsics[index])
    place = ((np.asarray(views.points) - pose[:3, 3]) @ pose[:3, :3]) @ matrix.T
    height, width = views.images.shape[1:3]
    column = np.clip(np.round(place[:, 0] / place[:, 2]).astype(int), 0, width - 1)
    row = np.clip(np.round(place[:, 1] / place[:, 2]).astype(int), 0, height - 1)
    return row, column
