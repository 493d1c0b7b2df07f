"""What the depth experiments share: methods, losses, scores."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax.depth import EdgeDepth, NearestLabels, PointWeight
from mvedge_jax.edges import scene_range
from mvedge_jax.edges.sides import BidirectionalSides, NoSides, ReprojectionSides, ThesisSides
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import boundary_scores, depth_scores
from mvedge_jax.photometry.matching import plane_sweep


class Method(NamedTuple):
    """A named way from a light field to a disparity map."""

    name: str
    run: Callable[[LightField], jax.Array]


Part = Callable[[EdgeDepth], Any]


def chain(name: str, parts: Mapping[str, Part] | None = None, **options: Any) -> Method:
    """An `EdgeDepth` with the options of `for_light_field`, and with other parts.

    Args:
        name: of the row.
        parts: by name, made of the model that they go into.
        **options: preset, views and choices.
    """

    def run(light_field: LightField) -> jax.Array:
        model = EdgeDepth.for_light_field(light_field, **options)
        model = model.replace({part: make(model) for part, make in (parts or {}).items()})
        return model(light_field, key=jax.random.key(0)).disparity

    return Method(name, run)


def pointwise(name: str, sides: Part, *, gain: float = 3.0, **options: Any) -> Method:
    """Our points alone on their nearest pixels, diffused; a gain of 0 switches (6.3) off."""

    def labels(model: EdgeDepth) -> NearestLabels:
        del model
        return NearestLabels(PointWeight(gain=jnp.asarray(gain)))

    return chain(name, {"labels": labels, "sides": sides}, preset="edges", **options)


def sweep(light_field: LightField) -> jax.Array:
    """The plane sweep of the crosshair, over a measured range where none is given."""
    return plane_sweep(light_field, disparity_range=scene_range(light_field)).disparity


def _bidirectional(model: EdgeDepth) -> BidirectionalSides:
    del model
    return BidirectionalSides()


def _reprojection(model: EdgeDepth) -> ReprojectionSides:
    assert model.measurement is not None
    return ReprojectionSides(radius=model.measurement.radius)


_QUANTIZED, _BLURRED = ({"refine.sharpen.mode": mode} for mode in ("quantized", "none"))
OURS = chain("ours")
EVERY = chain("ours, all views", views="all")
SWEEP = Method("plane sweep", sweep)
THESIS = chain("thesis", preset="thesis")
# Points only, as in the thesis, and the ways to place them.
SPARSE = (
    pointwise("edges only, bidirectional", _bidirectional),
    pointwise("edges only, thesis' response", lambda _: ThesisSides()),
    pointwise("edges only, reprojection", _reprojection),
    pointwise("edges only, naive", lambda _: NoSides()),
)
ABLATIONS = (
    chain("ours, quantized median", choices=_QUANTIZED),
    chain("ours, no sharpening", choices=_BLURRED),
    pointwise("edges only, quantized median", _bidirectional, choices=_QUANTIZED),
    pointwise("edges only, no sharpening", _bidirectional, choices=_BLURRED),
    pointwise("edges only, unit weights", _bidirectional, gain=0.0),
)


def score(
    name: str, method: Method, light_field: LightField, seconds: float, disparity: jax.Array
) -> dict[str, Any]:
    """One row of a table, full frame; says that it is done, as most of them are slow."""
    truth = light_field.truth
    if truth is None:
        raise ValueError(f"scene {name} has no ground truth to score against.")
    depth = depth_scores(disparity, truth.disparity, mask=truth.valid)
    inner = depth_scores(disparity, truth.disparity, mask=truth.valid, crop=15)
    boundary = boundary_scores(disparity, truth.disparity, mask=truth.valid)
    print(f"{name}, {method.name}: MSE*100 {float(depth.mse):.4g}", flush=True)
    return {
        "scene": name,
        "method": method.name,
        "MSE*100": float(depth.mse),
        "Q25*100": float(depth.q25),
        "BP(.01)": float(depth.bad_01),
        "BP(.03)": float(depth.bad_03),
        "BP(.07)": float(depth.bad_07),
        "MSE*100 crop 15": float(inner.mse),
        "BP(.07) crop 15": float(inner.bad_07),
        "mean F1": float(boundary.mean_f1),
        "peak F1": float(boundary.peak_f1),
        "AUC": float(boundary.auc),
        "seconds": round(seconds, 2),
    }


def as_image(disparity: jax.Array, truth: jax.Array) -> np.ndarray:
    """A map and its absolute error on a log scale, side by side, 8 bit BGR."""
    import cv2

    low, high = float(truth.min()), float(truth.max())
    level = np.clip((np.asarray(disparity) - low) / (high - low), 0, 1)
    error = np.log10(np.abs(np.asarray(disparity - truth)) + 1e-4)
    pictures = (
        cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_TURBO),
        cv2.applyColorMap(np.clip(64 * error + 256, 0, 255).astype(np.uint8), cv2.COLORMAP_INFERNO),
    )
    return np.concatenate(pictures, axis=1)
