"""The parts that each preset of `EdgeDepth` is made of."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.core import Tracer

from mvedge_jax._params import as_number
from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import OrientedEdges, scene_range
from mvedge_jax.edges.sides import BidirectionalSides, ThesisSides
from mvedge_jax.edges.thesis import ThesisEdges
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import AsIs, Calibrate, hypothesis_count, occluder_radius
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import LabelViews, Measurement
from mvedge_jax.smoothness import ColorAndDepth

from ._dense import MeasuredLabels
from ._labels import NearestLabels, SharedLabels, SplattedLabels
from ._refine import Refine
from ._sharpen import Sharpen

if TYPE_CHECKING:
    from ._edge_depth import EdgeDepth

PRESETS = ("full", "edges", "thesis")
# Points per pixel to reserve, which sets shapes: memory; what finds no slot is counted.
_FILL = 0.65
# Ranges of files are rounded, a number format: beyond so much, px per view step, they are others.
_ROUNDED = 0.02


def parts_for(light_field: LightField, preset: str, views: LabelViews) -> dict[str, Any]:
    """The fields of `EdgeDepth` for a light field; see `EdgeDepth.for_light_field`."""
    if preset not in PRESETS:
        raise ValueError(f"`preset` must be one of {PRESETS}, got {preset!r}.")
    steps = max(light_field.centre)
    if steps == 0:
        raise ValueError(
            "`light_field` has a single view; depth needs at least three in a row or column."
        )
    low, high = scene_range(light_field)
    height, width = light_field.views.shape[2:4]
    capacity = max(int(_FILL * height * width), 1)
    if preset == "thesis":
        # A filter beyond either end of the range, so that its ends are no border of the bank.
        reach = round(1.05 * max(abs(low), abs(high), 0.1), 3)
        return {
            "calibration": AsIs(),
            "measurement": None,
            "edges": ThesisEdges(reach=reach, capacity=capacity),
            "sides": ThesisSides(),
            "labels": NearestLabels(),
            "dense": None,
            "smoothness": ColorAndDepth(),
            "solver": _solver(),
            "refine": Refine(slopes=None, sharpen=Sharpen(), outlines=False),
            "searched": (-reach, reach),
        }
    # In whole filters, so that ranges of nearly equal length share a program.
    spacing = OrientedEdges.spacing
    first = math.floor(round(low / spacing, 6)) - 1
    last = math.ceil(round(high / spacing, 6)) + 1
    edges = OrientedEdges(first=first, filters=last - first + 1, capacity=capacity)
    radius = occluder_radius(high - low, steps, (height, width))
    hypotheses = hypothesis_count(high - low + 0.2, steps)
    common = {
        "calibration": Calibrate(Matching(), hypotheses),
        "measurement": Measurement(radius=radius, views=views),
        "edges": edges,
        "smoothness": ColorAndDepth(),
        "solver": _solver(),
        "searched": edges.searched,
    }
    if preset == "edges":
        return common | {
            "sides": ThesisSides(),
            "labels": SplattedLabels(),
            "dense": None,
            "refine": Refine(precision=as_number(0.008), solves=3, outlines=False),
        }
    return common | {
        "sides": BidirectionalSides(),
        "labels": SharedLabels(),
        "dense": MeasuredLabels(),
        "refine": Refine(),
    }


def _solver() -> AutoSolver:
    # By the estimated error, solves take up to five times the steps for the same map: most of that
    # error is in pixels without any label to speak of.
    return AutoSolver(tolerance=1e-5, by_residual=True)


def check_covers(light_field: LightField, model: "EdgeDepth") -> None:
    """Refuses a model made for another range of disparities; silent where the range is traced.

    Args:
        light_field: whose range counts.
        model: what it searches has to cover it.

    Raises:
        ValueError: it does not.
    """
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
