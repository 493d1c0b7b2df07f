"""`mvedge eval`: scores a disparity map against a scene's ground truth."""

from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import numpy as np
import tyro

from mvedge_jax.datasets import load_ground_truth, read_pfm
from mvedge_jax.metrics import DepthScores, depth_scores

from ._common import SCORES, aligned, note, stage, warn
from ._output import output_folder, write_csv, write_json

_COLUMNS = {"mse": SCORES["mse"], "mae": "MAE"} | SCORES
_COLUMNS |= {"edge_mse": "edge MSE*100", "edge_bad_07": "edge BP(0.07) %"}


def evaluate(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT.pfm")],
    scene: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    /,
    *,
    crop: int = 15,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")] = None,
    overwrite: bool = False,
) -> None:
    """Scores a disparity map against the ground truth of a scene.

    Scores are over the whole frame (as in the thesis) and without CROP pixels per side (as in the
    HCI benchmark). A map smaller than the ground truth is taken as its center.

    Args:
        result: disparity map of the center view (.pfm), px per view step, larger is nearer.
        scene: folder or file of a light field with ground truth.
        crop: pixels to leave out on each side of the ground truth, in addition to the full frame.
        out: folder for scores.json, scores.csv, the error maps and the disparity map.
        overwrite: replace FOLDER if it is a result of mvedge without other files in it.
    """
    disparity = read_pfm(result)
    with stage(f"reading the ground truth of {scene}"):
        ground_truth = load_ground_truth(scene)
    truth = np.where(np.asarray(ground_truth.valid), np.asarray(ground_truth.disparity), np.nan)
    top, left = _margin(result, disparity.shape, scene, truth.shape)
    if crop < 0 or 2 * crop >= min(truth.shape):
        raise ValueError(
            f"--crop must be at least 0 and leave pixels of the {truth.shape[0]}x{truth.shape[1]} "
            f"ground truth, got {crop}."
        )
    if (top, left) != (0, 0):
        note(
            f"{result} is {disparity.shape[1]}x{disparity.shape[0]} px: it is taken to be the "
            f"center of the ground truth's {truth.shape[1]}x{truth.shape[0]} px, without {left} "
            f"columns at the left and {top} rows at the top. Crops count from the border of the "
            "ground truth; crop 0 is all there is."
        )
    window = np.s_[top : top + disparity.shape[0], left : left + disparity.shape[1]]
    with stage("scoring"):
        scores = {size: _score(disparity, truth, window, size) for size in sorted({0, crop})}
    note(_table(scores))
    bad = int(scores[0].not_finite)
    if bad:
        warn(f"{bad} disparities of {result} are NaN or infinite; they count as wrong.")
    if out is not None:
        with output_folder(out, inputs=[result, scene], overwrite=overwrite) as folder:
            _write_scores(folder, result, scene, scores)
            _draw(folder, result.stem, disparity, truth[window], scores[0])
        note(f"written to {out}")


def _margin(
    result: Path, size: tuple[int, ...], scene: Path, full: tuple[int, ...]
) -> tuple[int, int]:
    """Rows and columns of the ground truth before the first one of the map."""
    margins = [whole - part for whole, part in zip(full, size, strict=True)]
    if min(margins) < 0:
        raise ValueError(
            f"{result} is {size[1]}x{size[0]} px (width x height), larger than the ground truth of "
            f"{scene}, {full[1]}x{full[0]} px; expected that size or a central part of it."
        )
    return margins[0] // 2, margins[1] // 2


def _score(disparity: np.ndarray, truth: np.ndarray, window: tuple, crop: int) -> DepthScores:
    """Scores the pixels of the map that are `crop` px or more inside the ground truth."""
    # As a mask, so that the band around depth edges does not depend on the crop.
    inside = np.zeros(truth.shape, bool)
    inside[crop : truth.shape[0] - crop, crop : truth.shape[1] - crop] = True
    if not inside[window].any():
        raise ValueError(f"--crop {crop} leaves nothing of the disparity map.")
    counted = np.isfinite(truth) & inside
    return depth_scores(
        jnp.asarray(disparity), jnp.asarray(truth[window]), mask=jnp.asarray(counted[window])
    )


def _table(scores: dict[int, DepthScores]) -> str:
    rows = [["crop", *_COLUMNS.values(), "pixels"]]
    for crop, values in scores.items():
        cells = [f"{float(getattr(values, name)):#.4g}" for name in _COLUMNS]
        rows.append([str(crop), *cells, str(int(values.pixels))])
    return aligned(rows)


def _write_scores(folder: Path, result: Path, scene: Path, scores: dict[int, DepthScores]) -> None:
    records = [
        {"crop": crop}
        | {name: float(getattr(values, name)) for name in _COLUMNS}
        | {"not_finite": int(values.not_finite), "pixels": int(values.pixels)}
        for crop, values in scores.items()
    ]
    summary = {"result": str(result), "scene": str(scene), "scores": records}
    write_json(folder / "scores.json", summary)
    # Infinite and undefined scores are left empty.
    rows = ([v if np.isfinite(v) else "" for v in record.values()] for record in records)
    write_csv(folder / "scores.csv", records[0], rows)


def _draw(
    folder: Path, name: str, disparity: np.ndarray, truth: np.ndarray, scores: DepthScores
) -> None:
    """The map beside the ground truth in the same colors, and its errors, signed and log."""
    # Matplotlib is slow to import, and only needed with --out.
    from mvedge_jax.plotting import disparity_limits, plot_comparison, plot_disparity, plot_error

    caption = f"MSE*100 {float(scores.mse):.3f}, BadPix(0.07) {float(scores.bad_07):.2f} %"
    for file, figure in (
        ("comparison", plot_comparison([disparity], truth, names=[name], captions=[caption])),
        ("disparity", plot_disparity(disparity, limits=disparity_limits([truth], percent=0.0))),
        ("error_signed", plot_error(disparity, truth, kind="signed")),
        ("error_log", plot_error(disparity, truth, kind="log")),
    ):
        figure.savefig(folder / f"{file}.png")
