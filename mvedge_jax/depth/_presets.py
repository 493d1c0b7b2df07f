"""The parts that each preset of `EdgeDepth` is made of."""

import math
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from jax.core import Tracer

from mvedge_jax._params import as_number
from mvedge_jax._paths import describe
from mvedge_jax._positions import check_regular
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import OrientedEdges, scene_range
from mvedge_jax.edges.sides import MapSides, ThesisSides
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import AsIs, Calibrate, hypothesis_count, occluder_radius
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import Measurement
from mvedge_jax.smoothness import ColorAndDepth, ThesisSmoothness

from ._dense import MeasuredLabels
from ._labels import NearestLabels, SharedLabels, SplattedLabels, StepWeight
from ._learned import learned_labels, learned_numbers
from ._refine import Refine
from ._sharpen import Sharpen

if TYPE_CHECKING:
    from ._edge_depth import EdgeDepth

# Relative residuals at which diffusions stop. With labels at edges alone, the right-hand side is
# so small that single precision gets no further; maps do not change.
_DENSE, _SPARSE = 1e-5, 1e-4
Preset = Literal["full", "learned", "edges", "thesis"]
PRESETS = get_args(Preset)
# Slots for points, per pixel. They set shapes and memory; overflow is counted.
_FILL = 0.65
# Ranges in files are rounded: differences up to this, px per view step, are ignored.
_ROUNDED = 0.02

# Defaults in px per view step are for light fields with views this far from the center view.
_REACH = 4
_PER_STEP = (
    "measurement.largest_step",
    "measurement.slant",
    "edges.error_limit",
    "sides.vote.cap",
    "sides.vote.temperature",
    "labels.agreement",
    "dense.agreement",
    "smoothness.depth",
    "refine.precision",
    "refine.parted",
    "refine.slopes.steepest",
    "refine.sharpen.slack",
    "refine.outline.step",
    "refine.error.half",
    "refine.error.rival",
    "refine.error.step",
)


def parts_for(
    light_field: LightField, preset: str, views: Literal["crosshair", "all"]
) -> dict[str, Any]:
    """The fields of `EdgeDepth` for a light field; see `EdgeDepth.for_light_field`."""
    if preset not in PRESETS:
        raise ValueError(f"`preset` must be one of {PRESETS}, got {preset!r}.")
    steps = light_field.farthest
    if max(light_field.center) == 0:
        raise ValueError(
            "`light_field` has a single view; depth needs at least three in a row or column."
        )
    low, high = scene_range(light_field)
    height, width = light_field.views.shape[2:4]
    capacity = max(int(_FILL * height * width), 1)
    if preset == "thesis":
        check_regular(light_field, "the preset 'thesis'")
        # One filter beyond either end, so that the ends of the range are not borders of the bank.
        reach = round(1.05 * max(abs(low), abs(high), 0.1), 3)
        return {
            "calibration": AsIs(),
            "measurement": None,
            "edges": ThesisEdges(reach=reach, capacity=capacity),
            "sides": ThesisSides.printed(),
            "labels": NearestLabels(StepWeight()),
            "dense": None,
            "smoothness": ThesisSmoothness(),
            "solver": _solver(_SPARSE),
            "refine": Refine(slopes=None, sharpen=Sharpen(mode="median"), outline=None, solves=1),
            "searched": (-reach, reach),
        }
    # In whole filters, so that ranges of nearly equal length share a program.
    spacing = OrientedEdges.spacing
    first = math.floor(round(low / spacing, 6)) - 1
    last = math.ceil(round(high / spacing, 6)) + 1
    edges = OrientedEdges(
        first=first,
        filters=last - first + 1,
        capacity=capacity,
        farthest=None if light_field.positions is None else steps,
    )
    radius = occluder_radius(high - low, steps, (height, width))
    hypotheses = hypothesis_count(high - low + 0.2, steps)
    common = {
        "calibration": Calibrate(Matching(), hypotheses),
        "measurement": Measurement(radius=radius, views=views),
        "edges": edges,
        "smoothness": ColorAndDepth(),
        "solver": _solver(_SPARSE if preset == "edges" else _DENSE),
        "searched": edges.searched,
    }
    if preset == "edges":
        return common | {
            "sides": ThesisSides(),
            "labels": SplattedLabels(),
            "dense": None,
            "refine": Refine(precision=as_number(0.008), solves=3, outline=None),
        }
    return common | {
        "sides": MapSides(),
        "labels": SharedLabels(),
        "dense": learned_labels() if preset == "learned" else MeasuredLabels(),
        "refine": Refine(),
    }


def learned(preset: str) -> dict[str, Any]:
    """Numbers for 9x9 views that are not the defaults of parts, by path."""
    return learned_numbers() if preset == "learned" else {}


def for_few_views(model: "EdgeDepth", farthest: int) -> dict[str, Any]:
    """Numbers in px per view step for light fields of fewer than 9x9 views.

    A disparity is observed as a shift in the outermost view, so with fewer view steps the same
    shift means a larger disparity. Numbers grow in proportion, except `measurement.same_surface`,
    which also separates surfaces at outlines and grows with the square root.

    Args:
        model: a preset's model with the numbers for 9x9 views.
        farthest: view steps from the center view to the outermost one.

    Returns:
        Values by path; none for 9x9 views and more.
    """
    if farthest >= _REACH or isinstance(model.edges, ThesisEdges):
        return {}
    more, known = _REACH / farthest, {row.path: row.value for row in describe(model)}
    values = {path: more * known[path] for path in _PER_STEP if path in known}
    same = "measurement.same_surface"
    return values | {same: more**0.5 * known[same]}


def _solver(tolerance: float) -> AutoSolver:
    # A bound on the estimated error takes up to five times the steps for the same map, because
    # most of that error is in pixels without a significant label.
    return AutoSolver(tolerance=as_number(tolerance), by_residual=True)


def check_covers(light_field: LightField, model: "EdgeDepth") -> None:
    """Refuses a model made for other positions of the views or another range of disparities.

    Args:
        light_field: its range and positions are checked unless they are traced.
        model: its searched range has to cover that of the light field.

    Raises:
        ValueError: the model does not cover the light field.
    """
    _check_positions(light_field, model)
    known = light_field.disparity_range
    if known is None or isinstance(known, Tracer):
        return
    low, high = map(float, np.asarray(known))
    first, last = model.searched
    if low < first - _ROUNDED or high > last + _ROUNDED:
        raise ValueError(
            f"`model` searches disparities from {first:.4g} to {last:.4g}, but `light_field` says "
            f"{low:.4g} to {high:.4g} px; make it by `EdgeDepth.for_light_field(light_field)`."
        )


def _check_positions(light_field: LightField, model: "EdgeDepth") -> None:
    """Refuses a model whose filters are not those of the views' positions."""
    edges, positions = model.edges, light_field.positions
    if isinstance(edges, ThesisEdges):
        check_regular(light_field, "`ThesisEdges`")
    if not isinstance(edges, OrientedEdges):
        return
    made = "make it by `EdgeDepth.for_light_field(light_field)`"
    if (positions is None) != (edges.farthest is None):
        kinds = ("with `positions`", "on a regular grid")
        of, own = kinds if positions is None else kinds[::-1]
        raise ValueError(
            f"`model` is for views {of}, but those of `light_field` are {own}; {made}."
        )
    if positions is None or edges.farthest is None or isinstance(positions, Tracer):
        return
    if light_field.farthest > edges.farthest:
        raise ValueError(
            f"`model` is for views up to {edges.farthest} view steps from the center view, but "
            f"`light_field` has views up to {light_field.farthest} away; {made}."
        )
