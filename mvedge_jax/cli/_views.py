"""`mvedge views`: a disparity map of every view."""

from pathlib import Path
from typing import Annotated, Any

import h5py
import numpy as np
import tyro

from mvedge_jax import plotting
from mvedge_jax.all_views import ViewDepths
from mvedge_jax.datasets import write_pfm
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import view_consistency
from mvedge_jax.metrics.depth import bad_pixels, mse

from ._common import note, stage, warn
from ._every_view import every_view
from ._model import FULL, ModelArg
from ._output import output_folder, write_animation, write_json
from ._source import read_scene, source_of


def views(
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    views: int | None = None,
    overwrite: bool = False,
    options: ModelArg = FULL,
    seed: int = 0,
) -> None:
    """Estimates the disparity of every pixel of every view of a light field.

    OUT gets disparity_Cam000.pfm and so on, numbered row by row as in the HCI benchmark, views.h5
    with disparity, standard error and source of every pixel, views.png with all maps, views.gif
    that moves over the grid, consistency.png and report.json. With ground truth of all views:
    error.png and scores.

    Args:
        scene: folder or file of a light field; `mvedge info` checks it.
        out: folder to write.
        views: use the central VIEWS x VIEWS views only; odd.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        options: options of the model of the center view.
        seed: seed of the random search of preset thesis.
    """
    options.check()
    with stage("reading"):
        light_field, said = read_scene(scene, views=views)
    with output_folder(out, inputs=[scene], overwrite=overwrite) as folder:
        blind = light_field.without_truth()
        found, model, seconds, doubts = every_view(blind, options=options, seed=seed)
        with stage("writing"):
            _write(folder, found)
            report = {"scene": light_field.name, "seconds": seconds, **_report(found)}
            report |= options.described(model) | {"seed": seed}
            report["scores"] = _score(folder, light_field, found)
            report["source"] = source_of(scene, views=views)
            report["warnings"] = doubts = [*said, *doubts]
            write_json(folder / "report.json", report)
    for doubt in doubts:
        warn(doubt)
    for name, value in report["scores"].items():
        note(f"{name} {value:.4g}")
    note(f"{seconds:.1f} s for all views; written to {out}")


def _write(folder: Path, found: ViewDepths) -> None:
    maps = np.asarray(found.disparity)
    rows, columns = maps.shape[:2]
    for v, u in np.ndindex(rows, columns):
        write_pfm(folder / f"disparity_Cam{columns * v + u:03d}.pfm", maps[v, u])
    with h5py.File(folder / "views.h5", "w") as file:
        for name in ("disparity", "error", "source"):
            data = np.asarray(getattr(found, name))
            file.create_dataset(name, data=data, compression="gzip", compression_opts=1)
        file.attrs["axes"] = "v, u, y, x"
        file.attrs["source"] = "0: seen by the center view, 1: by other views only, 2: by none"
    plotting.plot_view_maps(maps).savefig(folder / "views.png")
    write_animation(folder / "views.gif", plotting.view_frames(maps))


def _report(found: ViewDepths) -> dict[str, Any]:
    source = np.asarray(found.source)
    shares = {name: float((source == k).mean()) for k, name in enumerate(("center", "other"))}
    return {
        "shape [v, u, y, x]": list(source.shape),
        "share of pixels known from": {**shares, "none": float((source == 2).mean())},
        "samples without a slot": int(found.overflow),
    }


def _score(folder: Path, light_field: LightField, found: ViewDepths) -> dict[str, float]:
    """Consistency, and mean scores of all views with ground truth; writes pictures of both."""
    consistency = view_consistency(found.disparity, available=light_field.available)
    grid = np.asarray(consistency.per_view)[..., None, None]
    plotting.plot_view_maps(grid, name="consistency, px²").savefig(folder / "consistency.png")
    scores = {"consistency*100": 100 * float(consistency.mean)}
    truth = light_field.truth
    if truth is None or truth.view_disparity is None:
        return scores
    pairs = [
        (found.disparity[v, u], truth.view_disparity[v, u])
        for v, u in np.ndindex(found.disparity.shape[:2])
    ]
    error = np.abs(np.asarray(found.disparity - truth.view_disparity))
    plotting.plot_view_maps(error, limits=(0, 0.3), name="error, px").savefig(folder / "error.png")
    return {
        **scores,
        "MSE*100": float(np.mean([mse(*pair) for pair in pairs])),
        "BP(0.07) %": float(np.mean([bad_pixels(*pair, 0.07) for pair in pairs])),
    }
