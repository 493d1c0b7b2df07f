"""`mvedge depth --tile`, `--memory`: images that are too large for the memory."""

import time
import warnings
from pathlib import Path
from typing import Any

from jaxtyping import PRNGKeyArray

from mvedge_jax._stored_views import StoredViews
from mvedge_jax.datasets import load_ground_truth, open_source
from mvedge_jax.datasets.stored import load_stored_views
from mvedge_jax.depth import DepthResult, EdgeDepth
from mvedge_jax.lightfield import GroundTruth
from mvedge_jax.tiles import Tiling, depth_in_tiles, with_measured_range

from ._common import progress_bar, stage
from ._model import ModelOptions


def in_tiles(
    tile: int | None, memory: float | None, *, all_views: bool, scale: float, view: bool
) -> bool:
    """Whether the options ask for tiles; refuses those that contradict each other or fit none."""
    if tile is None and memory is None:
        return False
    given = f"--tile {tile}" if memory is None else f"--memory {memory:g}"
    if tile is not None and memory is not None:
        raise ValueError("--tile and --memory both say how large tiles are; leave out one.")
    for name, wrong in (("--all-views", all_views), ("--scale", scale != 1), ("--view", view)):
        if wrong:
            raise ValueError(
                f"{given} estimates depth in tiles of the views of the crosshair at their full "
                f"size, for which there is no {name}; leave out one of both."
            )
    _tiling(tile, memory, None).of(1, 1)
    return True


def _tiling(tile: int | None, memory: float | None, stored: StoredViews | None) -> Tiling:
    if memory is not None:
        return Tiling.within(1e9 * memory, views=stored)
    return Tiling() if tile is None else Tiling(side=tile)


def read_stored(
    scene: Path, *, range: tuple[float, float] | None, **reading: Any
) -> tuple[StoredViews, GroundTruth | None, list[str]]:
    """The crosshair of a light field, its ground truth if any, and warnings of the reader."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        stored = load_stored_views(scene, disparity_range=range, **reading)
        with open_source(scene) as source:
            known = source.truth is not None
        truth = load_ground_truth(scene) if known else None
    return stored, truth, [str(one.message) for one in caught if one.category is UserWarning]


def estimate_tiles(
    stored: StoredViews,
    tile: int | None,
    memory: float | None,
    options: ModelOptions,
    *,
    key: PRNGKeyArray,
) -> tuple[EdgeDepth, DepthResult, dict[str, float]]:
    """The model, the depth, and the seconds it took, compilation included."""
    tiling = _tiling(tile, memory, stored)
    start = time.perf_counter()
    with stage("choosing sizes"):
        stored = with_measured_range(stored)
        first = tiling.of(*stored.shape[2:])[0]
        model = options.model(stored.window(first.window))
    with progress_bar() as bar:
        task = bar.add_task("tiles", total=None)

        result = depth_in_tiles(
            stored,
            model=model,
            tiling=tiling,
            key=key,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    return model, result, {"estimation": round(time.perf_counter() - start, 3)}
