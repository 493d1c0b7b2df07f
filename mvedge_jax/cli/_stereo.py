"""`mvedge stereo`: depth of posed photographs."""

import time
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from mvedge_jax import plotting
from mvedge_jax.datasets import write_pfm
from mvedge_jax.datasets.photographs import load_photographs, open_photographs
from mvedge_jax.model.optimization import Progress
from mvedge_jax.posed import Photographs, Reference, StereoDepth, reference_of, stereo as estimate
from mvedge_jax.posed.scores import depth_errors
from mvedge_jax.posed.sparse import SparseStereoDepth, sparse_stereo

from ._common import note, stage, warn
from ._model import Settings, described, settings_of, settled
from ._output import output_folder, write_json
from ._paths import stems_of


def stereo(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    /,
    *,
    reference: str = "all",
    method: Literal["dense", "points"] = "dense",
    views: int = 9,
    images: Path | None = None,
    intrinsics: tuple[float, float, float, float] | None = None,
    range: tuple[float, float] | None = None,
    scale: float = 1.0,
    overwrite: bool = False,
    set: Settings = (),
) -> None:
    """Estimates the depth of every pixel of posed photographs.

    MODEL is a COLMAP model, a transforms.json of nerfstudio, or a folder of images with a list of
    poses. OUT gets, for every photograph NAME, NAME_depth.pfm and NAME_error.pfm (its standard
    error) in the unit of the model, NAME_depth.png and NAME_error.png (the disparity and its
    standard error, px), and report.json. Scores if true depth lies beside the images. Transparent
    pixels are ignored; their depth is NaN.

    Args:
        model: folder or file with the cameras.
        out: folder to write.
        reference: name of the photograph to estimate, or all.
        method: measure every pixel, or diffuse and optimize the sparse points as in the
            dissertation, which takes minutes instead of seconds and gives no standard error.
        views: largest number of photographs to measure in, the reference included: those that
            share most points with it, or whose cameras are nearest.
        images: folder of the photographs, if MODEL names another.
        intrinsics: fx fy cx cy, px, centers of pixels at integers; for lists of poses without a
            camera file.
        range: nearest and farthest depth, in the unit of the model; from the sparse points if not
            given.
        scale: shrink the photographs by this factor, at most 1.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        set: with method dense, a number or static field of the model by its path, such as
            smoothness.color=.3 or refine.solves=1; repeatable. report.json lists all paths.
    """
    if set and method != "dense":
        raise ValueError(f"--set needs --method dense, got {method}.")
    settled(StereoDepth(hypotheses=2), set)
    source = open_photographs(model, images=images, intrinsics=intrinsics)
    names = [frame.name for frame in source.frames]
    wanted = names if reference == "all" else [reference]
    inputs, stems = [model] if images is None else [model, images], stems_of(names)
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
                        points=range is None or method == "points",
                    )
            base = folder / stems[loaded.names[loaded.index(name)]]
            chosen = reference_of(loaded, name, depth_range=range)
            if method == "dense":
                rows[name] = _dense(base, loaded, name, chosen, set)
            else:
                rows[name] = _points(base, loaded, name, chosen)
        report = {
            "model": str(model.resolve()),
            "method": method,
            "layout": source.layout,
            "scale": scale,
            "origin": list(source.origin),
            "images": None if images is None else str(images.resolve()),
            "intrinsics": None if intrinsics is None else list(intrinsics),
            "photographs": rows,
        }
        write_json(folder / "report.json", report)
    note(f"depth of {len(rows)} photographs; written to {out}")


def _dense(
    base: Path, photographs: Photographs, name: str, chosen: Reference, settings: tuple[str, ...]
) -> dict[str, Any]:
    """Depth and its error by measurement; writes files and returns the report."""
    model = StereoDepth.of(chosen, choices=settings_of(settings))
    start = time.perf_counter()
    with stage(f"estimating depth of {name} (the first one compiles)"):
        result = jax.block_until_ready(estimate(photographs.without_truth(), chosen, model))
    seconds = time.perf_counter() - start
    write_pfm(_file(base, "error.pfm"), np.asarray(result.error))
    doubt = np.asarray(result.disparity_error)
    figure = plotting.plot_error(doubt, np.zeros_like(doubt), label="standard error (px)")
    figure.savefig(_file(base, "error.png"))
    error = np.asarray(result.error)[_opaque(photographs, chosen)]
    row = _written(base, photographs, chosen, result.depth, result.disparity) | {
        "seconds, compilation included": round(seconds, 3),
        "standard error, median": float(np.median(error)),
        "pixels without an accepted label, %": 100 * (1 - float(result.stats.labeled)),
        "noise of 255": 255 * float(result.stats.noise.deviation),
        "gains": dict(zip(photographs.names, np.asarray(result.stats.gain).tolist(), strict=True)),
        **described(model),
        "warnings": list(result.problems()),
    }
    for problem in row["warnings"]:
        warn(f"{name}: {problem}")
    return row


def _points(base: Path, photographs: Photographs, name: str, chosen: Reference) -> dict[str, Any]:
    """Depth by the thesis' method, from sparse points."""
    given = photographs.without_truth(), chosen, SparseStereoDepth()
    start = time.perf_counter()
    with stage(f"optimizing the points of {name}"):
        result = sparse_stereo(*given, key=jax.random.key(0), progress=_tell)
    seconds = time.perf_counter() - start
    loss = np.asarray(result.loss)
    return _written(base, photographs, chosen, result.depth, result.disparity) | {
        "seconds, compilation included": round(seconds, 3),
        "loss, before and after": [float(loss[0]), float(loss.min())] if loss.size else [],
        "points of the model": int(np.asarray(result.model.valid).sum()),
    }


def _opaque(photographs: Photographs, chosen: Reference) -> np.ndarray:
    """The opaque pixels of a photograph."""
    if photographs.mask is None:
        return np.ones(photographs.images.shape[1:3], bool)
    return np.asarray(photographs.mask[int(chosen.index)])


def _file(base: Path, end: str) -> Path:
    """A file of a photograph."""
    return base.with_name(f"{base.name}_{end}")


def _tell(now: Progress) -> None:
    note(f"  {now.iteration}/{now.iterations} loss {now.loss:.6f}")


def _written(
    base: Path, photographs: Photographs, chosen: Reference, depth: jax.Array, disparity: jax.Array
) -> dict[str, Any]:
    """Writes a depth map of either method and returns its report."""
    index, mask = int(chosen.index), _opaque(photographs, chosen)
    name = photographs.names[index]
    depths, disparities = (
        np.where(mask, values, np.nan) for values in map(np.asarray, (depth, disparity))
    )
    write_pfm(_file(base, "depth.pfm"), depths)
    figure = plotting.plot_disparity(disparities, label="disparity (px per baseline)")
    figure.savefig(_file(base, "depth.png"))
    row: dict[str, Any] = {
        "baseline": float(chosen.baseline),
        "disparity range": np.asarray(chosen.disparity_range).tolist(),
        "depth, 5, 50 and 95 %": np.quantile(depths[mask], (0.05, 0.5, 0.95)).tolist(),
        "measured in": list(photographs.names),
        "points": 0 if photographs.points is None else int(photographs.points.shape[0]),
    }
    if not mask.all():
        row["transparent, without depth %"] = 100 * float(1 - mask.mean())
        note(f"{name}: {100 * (1 - mask.mean()):.1f} % is transparent and has no depth (NaN)")
    truth = np.zeros(()) if photographs.depth is None else np.asarray(photographs.depth[index])
    truth = np.where(mask, truth, 0)
    if bool((truth > 0).any()):
        scores = depth_errors(jnp.asarray(depths), jnp.asarray(truth))
        row["scores"] = {
            "median relative error %": float(scores.median),
            "above 2 %": float(scores.above),
            "MSE*100": float(scores.mse),
            "Q25*100": float(scores.q25),
        }
        note(f"{name}: " + "  ".join(f"{key} {value:.4g}" for key, value in row["scores"].items()))
    return row
