"""`mvedge stereo`: depth of posed photographs."""

import time
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from mvedge_jax import plotting
from mvedge_jax.datasets import write_pfm
from mvedge_jax.datasets.photographs import load_photographs, open_photographs
from mvedge_jax.posed import (
    Photographs,
    StereoParams,
    StereoResult,
    StereoSizes,
    reference_of,
    stereo as estimate,
)
from mvedge_jax.posed.scores import depth_errors

from ._common import note, stage, warn
from ._output import output_folder, write_json


def stereo(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    reference: str = "all",
    views: int = 9,
    images: Path | None = None,
    intrinsics: tuple[float, float, float, float] | None = None,
    range: tuple[float, float] | None = None,
    scale: float = 1.0,
    overwrite: bool = False,
) -> None:
    """Estimates the depth of every pixel of posed photographs.

    MODEL is a COLMAP model, a transforms.json of nerfstudio, or a folder of images with a list of
    poses. OUT gets, for every photograph NAME, NAME_depth.pfm and NAME_error.pfm (its standard
    error) in the unit of the model, NAME_depth.png and NAME_error.png, and report.json. Where true
    depth lies beside the images: scores.

    Args:
        model: folder or file with the cameras.
        out: folder to make.
        reference: name of the photograph whose depth is wanted, or all.
        views: measure in at most so many photographs, the reference included: those that share most
            points with it, or whose cameras are nearest.
        images: folder of the photographs, where it is not where MODEL says.
        intrinsics: fx fy cx cy, px, centres of pixels at integers; for lists of poses without a
            camera file.
        range: nearest and farthest depth, in the unit of the model; from the sparse points if not
            given.
        scale: shrink the photographs by this factor, at most 1.
        overwrite: replace OUT if it is an earlier result of mvedge, with nothing else in it.
    """
    source = open_photographs(model, images=images, intrinsics=intrinsics)
    names = [frame.name for frame in source.frames]
    wanted = names if reference == "all" else [reference]
    inputs = [model] if images is None else [model, images]
    loaded: Photographs | None = None
    rows: dict[str, Any] = {}
    with output_folder(out, inputs=inputs, overwrite=overwrite) as folder:
        for name in wanted:
            if loaded is None or len(names) > views:
                with stage(f"reading {source.layout}, photographs around {name}"):
                    loaded = load_photographs(
                        model,
                        images=images,
                        intrinsics=intrinsics,
                        around=name,
                        most=views,
                        scale=scale,
                        points=range is None,
                    )
            rows[name] = _one(folder, loaded, name, range)
        report = {
            "model": str(model.resolve()),
            "layout": source.layout,
            "scale": scale,
            "images": None if images is None else str(images.resolve()),
            "intrinsics": None if intrinsics is None else list(intrinsics),
            "photographs": rows,
        }
        write_json(folder / "report.json", report)
    note(f"depth of {len(rows)} photographs; written to {out}")


def _one(
    folder: Path, photographs: Photographs, name: str, limits: tuple[float, float] | None
) -> dict[str, Any]:
    """Depth of a photograph: files, a line for the user, and what the report says."""
    chosen = reference_of(photographs, name, depth_range=limits)
    sizes = StereoSizes.of(chosen)
    start = time.perf_counter()
    with stage(f"estimating depth of {name} (the first one compiles)"):
        result = jax.block_until_ready(
            estimate(photographs.without_truth(), chosen, StereoParams(), sizes)
        )
    seconds = time.perf_counter() - start
    index = photographs.index(name)
    stem = Path(photographs.names[index]).with_suffix("")
    _write(folder, "_".join(stem.parts), result)
    depth, error = np.asarray(result.depth), np.asarray(result.error)
    row: dict[str, Any] = {
        "seconds, compilation included": round(seconds, 3),
        "baseline": float(chosen.baseline),
        "disparity range": np.asarray(chosen.disparity_range).tolist(),
        "depth, 5, 50 and 95 %": np.quantile(depth, (0.05, 0.5, 0.95)).tolist(),
        "standard error, median": float(np.median(error)),
        "noise of 255": 255 * float(result.stats.noise.deviation),
        "gains": dict(zip(photographs.names, np.asarray(result.stats.gain).tolist(), strict=True)),
        "measured in": list(photographs.names),
        "points": 0 if photographs.points is None else int(photographs.points.shape[0]),
        "hypotheses": sizes.hypotheses,
        "warnings": list(result.problems()),
    }
    for doubt in row["warnings"]:
        warn(f"{name}: {doubt}")
    if photographs.depth is not None and bool((photographs.depth[index] > 0).any()):
        scores = depth_errors(result.depth, photographs.depth[index])
        row["scores"] = {
            "median relative error %": float(scores.median),
            "above 2 %": float(scores.above),
            "MSE*100": float(scores.mse),
            "Q25*100": float(scores.q25),
        }
        note(f"{name}: " + "  ".join(f"{key} {value:.4g}" for key, value in row["scores"].items()))
    return row


def _write(folder: Path, stem: str, result: StereoResult) -> None:
    write_pfm(folder / f"{stem}_depth.pfm", np.asarray(result.depth))
    write_pfm(folder / f"{stem}_error.pfm", np.asarray(result.error))
    plotting.plot_disparity(np.asarray(result.disparity)).savefig(folder / f"{stem}_depth.png")
    error = np.asarray(result.disparity_error)
    figure = plotting.plot_error(error, np.zeros_like(error), name="standard error")
    figure.savefig(folder / f"{stem}_error.png")
