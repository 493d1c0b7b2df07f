"""What `mvedge batch` does with one light field, in its own process or on a worker."""

import functools
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax

from mvedge_jax.depth import DepthResult, EdgeDepth, estimate_depth
from mvedge_jax.edges import scene_range
from mvedge_jax.lightfield import LightField

from ._common import SCORES, compiled, stage
from ._depth import write_depth
from ._model import ModelOptions
from ._output import MARKER, output_folder
from ._source import read_json, read_scene, source_of
from ._video import Video


class Kind(NamedTuple):
    """What light fields of one program share; `farthest` is None for a regular grid."""

    shape: tuple[int, ...]
    dtype: str
    farthest: int | None


class Options(NamedTuple):
    """How light fields are read, and estimated; see `mvedge batch`."""

    views: int | None
    scale: float
    range: tuple[float, float] | None
    all_views: bool
    video: bool
    again: bool
    model: ModelOptions
    seed: int


def survey(
    scene: Path, options: Options, ranges: Mapping[Kind, tuple[float, float]]
) -> tuple[Kind, tuple[float, float]]:
    """Reads a light field; its kind and its disparity range, measured if not in `ranges`."""
    with stage(f"reading {scene}"):
        found = read_scene(scene, views=options.views, scale=options.scale)[0].without_truth()
    farthest = None if found.positions is None else found.farthest
    kind = Kind(found.views.shape, str(found.views.dtype), farthest)
    return kind, options.range or ranges.get(kind) or scene_range(found)


def make(
    name: str,
    scene: Path,
    out: Path,
    kind: Kind,
    ends: tuple[float, float],
    options: Options,
    before: tuple[Path, Path] | None = None,
) -> dict[str, Any]:
    """Estimates depth of a light field and writes its folder; returns the row of the summary.

    A folder that is complete is not made again: a worker may die after it wrote one. `ends` are
    lowest and highest disparity of all light fields of the kind, `before` the light field and the
    result of the frame before.
    """
    report_file = out / name / "report.json"
    if not options.again and (out / name / MARKER).exists():
        return row_of(report_file, "done")
    reading: dict[str, Any] = {"views": options.views, "scale": options.scale}
    with stage(f"reading {scene}"):
        found, said = read_scene(scene, **reading)
    estimate = estimate_of(kind, options, ends)
    result, model, seconds = estimate(found, name)
    # What is there is an earlier result of ours, or the folder refuses.
    with output_folder(out / name, inputs=[scene], overwrite=True) as folder:
        told = options.model.described(model) | {"seed": options.seed, "seconds": seconds}
        told["source"] = source_of(scene, **reading)
        if options.video:
            told["change"] = estimate.video.change(found, result, scene, before, **reading)
        write_depth(folder, found, found.truth, model, result, told | {"warnings": said})
    return row_of(report_file, "done")


def row_of(report: Path, state: str) -> dict[str, Any]:
    """What the summary says of a finished light field."""
    try:
        content = read_json(report)
        scores = content["scores"].get("crop 0", {})
        return {
            "state": state,
            "seconds": content["seconds"]["estimation"],
            "compilation": content["seconds"]["compilation"],
            "converged": content["converged"],
            **content.get("change", {}),
            "warnings": content.get("warnings", []),
            **{name: scores.get(name) for name in SCORES},
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {"state": state, "reason": f"{report} is not readable"}


class _Estimate:
    """Depth of light fields of one kind; compiled for the first, and for frames of wider range."""

    def __init__(self, kind: Kind, options: Options, ends: tuple[float, float]):
        # A program holds some 1300 memory maps, of which Linux allows 65530.
        jax.clear_caches()
        self._kind, self._options, self._ends = kind, options, ends
        self._key = jax.random.key(options.seed)
        self._program: tuple[Any, EdgeDepth] | None = None
        self.video = Video()

    def __call__(
        self, light_field: LightField, name: str
    ) -> tuple[DepthResult, EdgeDepth, dict[str, float]]:
        """Depth, the model it was found with, and the seconds it took."""
        # Names, cameras and ranges would make a program of their own.
        views = light_field.bare()
        start = time.perf_counter()
        program, model = self._compiled(views)
        ready = time.perf_counter()
        with stage(f"estimating depth of {name}"):
            result = jax.block_until_ready(program(views, model, key=self._key))
        seconds = {"compilation": ready - start, "estimation": time.perf_counter() - ready}
        fixed = self._options.range is not None
        if self._options.video and not fixed and result.problems() and self._widened(views, name):
            result, model, more = self(light_field, name)
            seconds = {key: seconds[key] + more[key] for key in seconds}
        return result, model, {key: round(value, 3) for key, value in seconds.items()}

    def _compiled(self, views: LightField) -> tuple[Any, EdgeDepth]:
        if self._program is None:
            with stage(f"compiling for views {'x'.join(map(str, self._kind.shape[:4]))}"):
                asked = self._options
                model = asked.model.model(views.with_range(*self._ends), all_views=asked.all_views)
                self._program = compiled(estimate_depth, views, model, key=self._key), model
        return self._program

    def _widened(self, views: LightField, name: str) -> bool:
        """Whether a frame shows disparities beyond the range that came from those before."""
        with stage(f"measuring the range of {name}"):
            low, high = scene_range(views)
        before = self._ends
        self._ends = min(low, before[0]), max(high, before[1])
        if self._ends == before:
            return False
        self._program = None
        return True


# The program of a kind, kept by the process until another kind comes.
estimate_of = functools.lru_cache(maxsize=1)(_Estimate)
