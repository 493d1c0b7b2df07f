"""`mvedge demo`: a synthetic light field, rendered, measured and drawn."""

import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import numpy as np
import tyro
from matplotlib.figure import Figure

from mvedge_jax import plotting
from mvedge_jax.datasets import synthetic, write_pfm
from mvedge_jax.depth import DepthResult, estimate_depth
from mvedge_jax.lightfield import GroundTruth, LightField
from mvedge_jax.metrics import (
    BoundaryScores,
    DepthScores,
    boundary_scores,
    depth_scores,
    reprojection_error,
)
from mvedge_jax.photometry.matching import plane_sweep

from ._common import SCORES, aligned, note, stage
from ._model import FULL, ModelArg, ModelOptions
from ._output import output_folder, write_csv, write_json

# Every method gets the light field without ground truth and is timed, scored and drawn in the same
# way; this library's is last.
_METHODS: dict[str, Callable[[LightField, ModelOptions, jax.Array], Any]] = {
    "plane sweep": lambda views, options, key: plane_sweep(views),
    "multi-view edges": lambda views, options, key: estimate_depth(
        views, options.model(views), key=key
    ),
}


class _Result(NamedTuple):
    """What a method found, a map and perhaps points, and its scores."""

    name: str
    found: Any
    seconds: float
    depth: DepthScores
    boundary: BoundaryScores
    reprojection: jax.Array

    def row(self) -> dict[str, float]:
        """Scores by the titles of their columns."""
        titles = SCORES | {"edge_mse": "edge MSE*100"}
        scores = {title: getattr(self.depth, name) for name, title in titles.items()}
        scores |= {"boundary F1": self.boundary.peak_f1, "boundary AUC": self.boundary.auc}
        scores["reprojection*100"] = self.reprojection
        return {title: float(score) for title, score in scores.items()}


def demo(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")] = Path("demo_out"),
    /,
    *,
    scene: str = "demo",
    views: int = 9,
    size: tuple[int, int] = (256, 256),
    seed: int = 0,
    overwrite: bool = False,
    options: ModelArg = FULL,
) -> None:
    """Renders a light field, estimates its depth, scores and draws it; takes a minute or two.

    The method is compared with a plane sweep of the crosshair. OUT gets figures (views, an
    epipolar-plane image with its lines, multi-view edges, disparity and error maps, precision and
    recall of depth boundaries), metrics.csv, metrics.json and the disparity maps.

    Args:
        out: folder to write.
        scene: a synthetic scene, see `mvedge render --help`.
        views: VIEWS x VIEWS views, an odd number of at least 3.
        size: height and width in px.
        seed: seed of the sensor's noise, and of the random search of preset thesis.
        overwrite: replace OUT if it is a result of mvedge without other files in it.
        options: options of the model.
    """
    options.check()
    if views < 3:
        raise ValueError(f"--views must be odd and at least 3, got {views}.")
    if min(size) < 32:
        raise ValueError(f"--size must be at least 32 x 32 px, got {size[0]} x {size[1]}.")
    world = synthetic.scene(scene)
    with output_folder(out, overwrite=overwrite) as folder:
        with stage(f"rendering {scene}, {views}x{views} views of {size[1]}x{size[0]} px"):
            light_field = synthetic.render(
                world, shape=(views, views, *size), key=jax.random.key(seed)
            )
            jax.block_until_ready(light_field.views)
        truth = light_field.truth
        assert truth is not None
        results = [_run(name, light_field, truth, options, seed) for name in _METHODS]
        with stage("writing figures and metrics"):
            for name, figure in _figures(light_field, truth, results):
                figure.savefig(folder / f"{name}.png")
            for result in results:
                path = folder / f"disparity_{result.name.replace(' ', '_')}.pfm"
                write_pfm(path, np.asarray(result.found.disparity))
            _write_metrics(folder, light_field, results, options)
    note(_table(results))
    note(f"figures and metrics are in {out}")


def _run(
    name: str, light_field: LightField, truth: GroundTruth, options: ModelOptions, seed: int
) -> _Result:
    given = light_field.without_truth(), options, jax.random.key(seed)
    with stage(f"estimating disparity: {name}, compilation included"):
        found = jax.block_until_ready(_METHODS[name](*given))
    with stage(f"timing a second run: {name}"):
        start = time.perf_counter()
        jax.block_until_ready(_METHODS[name](*given))
        seconds = time.perf_counter() - start
    with stage(f"scoring: {name}"):
        maps = (found.disparity, truth.disparity)
        depth = depth_scores(*maps, mask=truth.valid)
        boundary = boundary_scores(*maps, mask=truth.valid)
        reprojection = reprojection_error(found.disparity, light_field).error
    return _Result(name, found, seconds, depth, boundary, reprojection)


def _figures(
    light_field: LightField, truth: GroundTruth, results: list[_Result]
) -> list[tuple[str, Figure]]:
    """Figures by name, with a common color range of disparity."""
    known = np.where(np.asarray(truth.valid), np.asarray(truth.disparity), np.nan)
    names = [result.name for result in results]
    maps = [result.found.disparity for result in results]
    captions = [
        f"MSE*100 {float(r.depth.mse):.3g}    BP(0.07) {float(r.depth.bad_07):.3g} %"
        for r in results
    ]
    limits = plotting.disparity_limits([known], percent=0.0)
    edges = [
        plotting.plot_edges(
            light_field.center_view,
            r.found.points.xy,
            r.found.points.disparity,
            valid=r.found.points.valid,
            limits=limits,
        )
        for r in results
        if isinstance(r.found, DepthResult)
    ]
    return [
        ("views", plotting.plot_views(light_field)),
        *(("edges", figure) for figure in edges),
        ("epi", _epi(light_field, truth)),
        (
            "disparity",
            plotting.plot_disparity([known, *maps], names=["ground truth", *names], limits=limits),
        ),
        (
            "comparison",
            plotting.plot_comparison(
                maps, known, names=names, captions=captions, image=light_field.center_view
            ),
        ),
        ("error_signed", plotting.plot_error(maps[-1], known, kind="signed", name=names[-1])),
        ("boundaries", plotting.plot_precision_recall([r.boundary for r in results], names=names)),
    ]


def _epi(light_field: LightField, truth: GroundTruth) -> Figure:
    """The row whose disparities vary most, with lines where the image changes most."""
    known = np.where(np.asarray(truth.valid), np.asarray(truth.disparity), np.nan)
    row = int(np.nanargmax(np.nanmean(np.abs(np.diff(known, axis=1)), axis=1)))
    change = np.abs(np.diff(np.asarray(light_field.center_view)[row].mean(-1)))
    peaks = np.r_[False, (change[1:-1] >= change[:-2]) & (change[1:-1] > change[2:]), False]
    columns = np.flatnonzero(peaks)
    columns = columns[np.argsort(change[columns])[-40:]]
    # An edge belongs to the nearest of the surfaces beside it.
    around = np.clip(columns[:, None] + np.arange(-1, 3), 0, known.shape[1] - 1)
    nearer = np.fmax.reduce(known[row, around], axis=1)
    return plotting.plot_epi(
        light_field,
        row=row,
        positions=columns + 0.5,
        disparities=nearer,
        valid=np.isfinite(nearer),
        limits=plotting.disparity_limits([known], percent=0.0),
    )


def _table(results: list[_Result]) -> str:
    rows = [["method", *results[0].row(), "seconds"]]
    for result in results:
        cells = [f"{value:#.3g}" for value in result.row().values()]
        rows.append([result.name, *cells, f"{result.seconds:.2f}"])
    return aligned(rows)


def _write_metrics(
    folder: Path, light_field: LightField, results: list[_Result], options: ModelOptions
) -> None:
    rows = [
        {"scene": light_field.name, "method": r.name, **r.row(), "seconds": round(r.seconds, 3)}
        for r in results
    ]
    write_csv(folder / "metrics.csv", rows[0], (row.values() for row in rows))
    described = options.described(options.model(light_field.without_truth()))
    summary = {
        "scene": light_field.name,
        "shape [v, u, y, x]": list(light_field.views.shape[:4]),
        "crop": 0,
        "jax": jax.__version__,
        "device": jax.devices()[0].device_kind,
        "machine": platform.platform(),
        "methods": [
            {
                "name": result.name,
                "seconds": round(result.seconds, 3),
                **result.row(),
                **(described if isinstance(result.found, DepthResult) else {}),
            }
            for result in results
        ],
    }
    write_json(folder / "metrics.json", summary)
