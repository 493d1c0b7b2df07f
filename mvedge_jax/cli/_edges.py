"""`mvedge edges`: the sparse multi-view edges of a light field."""

from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from mvedge_jax import plotting
from mvedge_jax.depth import multiview_edges
from mvedge_jax.edges import Edges
from mvedge_jax.lightfield import LightField

from ._common import note, run, stage, warn
from ._model import FULL, ModelArg
from ._output import output_folder, write_json
from ._points import valid_points, write_points
from ._source import read_scene


def edges(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    views: int | None = None,
    scale: float = 1.0,
    flip_u: bool = False,
    flip_v: bool = False,
    swap_axes: bool = False,
    range: tuple[float, float] | None = None,
    overwrite: bool = False,
    options: ModelArg = FULL,
    seed: int = 0,
) -> None:
    """Finds edge points with their disparities in a light field's center view.

    OUT gets points.npz, points.csv (one row per point, for a spreadsheet), points.png (over the
    image, colored by disparity), epi_horizontal.png and epi_vertical.png (the EPI of either arm
    whose disparities vary most, with its lines) and report.json (the counts after each step).

    Args:
        scene: folder or file of a light field; `mvedge info` checks it.
        out: folder to write.
        views: use the central VIEWS x VIEWS views only; odd.
        scale: shrink the views by this factor, at most 1.
        flip_u: reverse the columns of views.
        flip_v: reverse the rows of views.
        swap_axes: exchange rows and columns of views, before they are reversed.
        range: lowest and highest disparity, px per view step; measured if unknown.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        options: options of the model.
        seed: seed of the random search of preset thesis.
    """
    options.check()
    with stage(f"reading {scene}"):
        read, said = read_scene(
            scene, views=views, scale=scale, flip_u=flip_u, flip_v=flip_v, swap_axes=swap_axes
        )
        light_field = read.without_truth()
    if range is not None:
        light_field = light_field.with_range(*range)
    with output_folder(out, inputs=[scene], overwrite=overwrite) as folder:
        with stage("choosing sizes"):
            model, key = options.model(light_field), jax.random.key(seed)
        found, spent = run("edges", "finding edges", multiview_edges, light_field, model, key=key)
        seconds = {"compilation": spent["compilation"], "finding": spent["estimation"]}
        with stage("writing"):
            _write(folder, light_field, found)
            report = {
                "scene": light_field.name,
                "shape [v, u, y, x]": list(light_field.views.shape[:4]),
                "disparities searched": list(model.searched),
                "seconds": seconds,
                "counts": {name: int(value) for name, value in vars(found.stats).items()},
                **options.described(model),
                "seed": seed,
                "warnings": (doubts := [*said, *_doubts(found)]),
            }
            write_json(folder / "report.json", report)
    for doubt in doubts:
        warn(doubt)
    for name, value in vars(found.stats).items():
        note(f"{name}: {int(value)}")
    note(f"{seconds['finding']:.1f} s; written to {out}")


def _doubts(found: Edges) -> list[str]:
    doubts = []
    if int(found.stats.overflow):
        doubts.append(f"{int(found.stats.overflow)} weak edges found no slot and were left out.")
    if not int(found.stats.valid):
        doubts.append("no edges were found; there is nothing to draw.")
    return doubts


def _write(folder: Path, light_field: LightField, found: Edges) -> None:
    points = valid_points(found.points)
    write_points(folder, points)
    if not len(points.disparity):
        return
    picture = plotting.plot_edges(
        light_field.center_view, points.xy, points.disparity, name=light_field.name, width=7.0
    )
    picture.savefig(folder / "points.png", dpi=200)
    for arm, name in enumerate(("horizontal", "vertical")):
        index = np.rint(points.xy[:, 1 - arm]).astype(int)
        busiest = _most_varied(np.maximum(index, 0), np.asarray(points.disparity))
        here = index == busiest
        figure = plotting.plot_epi(
            light_field,
            row=busiest if arm == 0 else None,
            column=busiest if arm == 1 else None,
            positions=points.xy[here, arm],
            disparities=points.disparity[here],
        )
        figure.savefig(folder / f"epi_{name}.png", dpi=200)


def _most_varied(index: np.ndarray, disparity: np.ndarray) -> int:
    """The EPI whose disparities vary most."""
    count, total, square = (
        np.bincount(index, weights=disparity.astype(np.float64) ** power) for power in range(3)
    )
    return int((square - total**2 / np.maximum(count, 1)).argmax())
