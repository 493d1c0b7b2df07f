"""`mvedge superpixels`: one label per surface patch in every view."""

from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
import tyro

from mvedge_jax import plotting
from mvedge_jax.datasets import write_hci
from mvedge_jax.edit import paint
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics.superpixels import labels_per_pixel, superpixel_scores
from mvedge_jax.superpixels import SuperpixelClustering, Superpixels, superpixels as cut

from ._common import in_unit_range, note, run, stage, warn
from ._every_view import every_view
from ._model import FULL, ModelArg
from ._output import output_folder, write_animation, write_csv, write_json
from ._source import read_scene


def superpixels(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    size: float = 20.0,
    count: int | None = None,
    pick: tuple[int, int] | None = None,
    color: tuple[float, float, float] = (0.9, 0.1, 0.1),
    views: int | None = None,
    overwrite: bool = False,
    options: ModelArg = FULL,
    seed: int = 0,
) -> None:
    """Segments a light field into superpixels that agree in all views.

    OUT gets labels.npy (int32, [v, u, y, x], 0 for none), superpixels.csv (a row per label:
    position, disparity plane, color, area, parent), neighbors.csv, superpixels.png, colors.png,
    superpixels.gif that moves over the grid, and report.json. With ground truth of all views:
    labels_per_pixel.png and scores. With --pick, edited/ is the light field with that superpixel
    recolored in every view.

    Args:
        scene: folder or file of a light field; `mvedge info` checks it.
        out: folder to write.
        size: side of a superpixel in the center view, px.
        count: approximate number of superpixels, in place of --size.
        pick: x and y in the center view, px, of a superpixel to recolor.
        color: red, green and blue of the picked superpixel, 0..1.
        views: use the central VIEWS x VIEWS views only; odd.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        options: options of the model of the center view's depth.
        seed: seed of the random search of preset thesis.
    """
    options.check()
    in_unit_range(color)
    with stage("reading"):
        light_field, said = read_scene(scene, views=views)
    height, width = light_field.views.shape[2:4]
    if count is not None:
        if count < 1:
            raise ValueError(f"--count must be at least 1, got {count}.")
        size = (height * width / count) ** 0.5
    if not 4 <= size <= min(height, width):
        raise ValueError(
            f"--size must be between 4 px and the shorter side, {min(height, width)} px, got "
            f"{size:.4g}."
        )
    if pick is not None and not (0 <= pick[0] < width and 0 <= pick[1] < height):
        raise ValueError(f"--pick must lie in the center view, {width}x{height} px, got {pick}.")
    blind = light_field.without_truth()
    with output_folder(out, inputs=[scene], overwrite=overwrite) as folder:
        depths, center, _, doubts = every_view(blind, options=options, seed=seed)
        doubts = [*said, *doubts]
        model = SuperpixelClustering.for_depths(depths, choices={"size": size})
        room = max(model.capacity, int(4 * height * width / size**2))
        model = model.replace(capacity=min(room, 32000))
        found, _ = run("superpixels", "cutting", cut, blind, depths, model)
        with stage("writing"):
            _write(folder, blind, found)
            report: dict[str, Any] = {"scene": light_field.name, "count": int(found.number)}
            report["size"] = size
            report |= options.described(center) | {"seed": seed}
            report["scores"] = _score(folder, light_field, found)
            if pick is not None:
                label = int(found.labels[(*light_field.center, pick[1], pick[0])])
                mask = (found.labels[light_field.center] == label).astype(blind.views.dtype)
                write_hci(
                    paint(blind, depths.disparity, mask, jnp.asarray(color)), folder / "edited"
                )
                report["picked"] = label
            if int(found.number) > model.capacity:
                lost = int(found.number) - model.capacity
                doubts.append(f"{lost} superpixels found no slot and have no label.")
            report["warnings"] = doubts
            write_json(folder / "report.json", report)
    for doubt in doubts:
        warn(doubt)
    note(f"{int(found.number)} superpixels; written to {out}")


def _write(folder: Path, light_field: LightField, found: Superpixels) -> None:
    labels, views = np.asarray(found.labels), np.asarray(light_field.views)
    np.save(folder / "labels.npy", labels)
    rows = np.flatnonzero(np.asarray(found.valid))
    numbers = np.concatenate(
        [np.asarray(a)[rows] for a in (found.xy, found.plane, found.color)], axis=1
    )
    wholes = np.stack([rows + 1, *(np.asarray(a)[rows] for a in (found.area, found.parents))])
    names = ("x", "y", "disparity", "slope_x", "slope_y", "red", "green", "blue")
    write_csv(
        folder / "superpixels.csv",
        ["label", *names, "area", "parent"],
        (
            [label, *(f"{value:.6g}" for value in values), area, parent]
            for (label, area, parent), values in zip(wholes.T, numbers, strict=True)
        ),
    )
    touching = np.column_stack([np.asarray(found.neighbors), np.asarray(found.linked)])
    used = touching[touching[:, 0] > 0]
    write_csv(folder / "neighbors.csv", ["label", "neighbor", "same_surface"], used)
    colors = plotting.label_colors(int(labels.max()))
    plotting.plot_superpixels(views, labels).savefig(folder / "superpixels.png")
    plotting.plot_superpixels(views, labels, colors=colors).savefig(folder / "colors.png")
    write_animation(folder / "superpixels.gif", plotting.superpixel_frames(views, labels))


def _score(folder: Path, light_field: LightField, found: Superpixels) -> dict[str, float]:
    """Scores that the ground truth allows: all, those of the center view, or shape alone."""
    truth, labels = light_field.truth, found.labels
    ids = disparity = None
    if truth is not None and truth.view_disparity is not None:
        ids, disparity = truth.view_ids, truth.view_disparity
        heat = labels_per_pixel(labels, disparity, available=light_field.available)
        plotting.plot_labels_per_pixel(heat).savefig(folder / "labels_per_pixel.png")
    elif truth is not None and truth.object_ids is not None:
        labels, ids = labels[light_field.center][None, None], truth.object_ids[None, None]
    whole = labels.shape == found.labels.shape
    available = light_field.available if whole else None
    scores = superpixel_scores(labels, ids, disparity, available=available)
    return {name: float(value) for name, value in scores._asdict().items()}
