"""What the depth experiments share: methods, losses, scores."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax.baselines import (
    SparseParams,
    SparseSizes,
    ThesisParams,
    ThesisSizes,
    plane_sweep,
    sparse_depth,
    thesis_depth,
)
from mvedge_jax.depth import Parameters, Sizes, edge_to_depth
from mvedge_jax.edges import EdgeParams, EdgeSizes, multiview_edges, scene_range
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import boundary_scores, depth_scores


class Method(NamedTuple):
    """A named way from a light field to a disparity map."""

    name: str
    run: Callable[[LightField], jax.Array]


def chain(name: str, **choices: Any) -> Method:
    """`edge_to_depth` with some of its `Sizes` set by hand."""

    def run(light_field: LightField) -> jax.Array:
        sizes = Sizes.for_light_field(light_field, **choices)
        return edge_to_depth(light_field, Parameters(), sizes).disparity

    return Method(name, run)


def sparse(name: str, *, unit_weights: bool = False, **choices: Any) -> Method:
    """Our points alone, diffused; `unit_weights` switches (6.3) off."""

    def run(light_field: LightField) -> jax.Array:
        params = SparseParams(gain=jnp.asarray(0.0)) if unit_weights else SparseParams()
        sizes = SparseSizes.for_light_field(light_field, **choices)
        grid = EdgeSizes.for_light_field(light_field)
        points = multiview_edges(light_field, EdgeParams(), grid).points
        return sparse_depth(light_field, points, params, sizes).disparity

    return Method(name, run)


def thesis(light_field: LightField) -> jax.Array:
    """The thesis' own chain, its points included."""
    params = ThesisParams(), SparseParams()
    sizes = ThesisSizes.for_light_field(light_field), SparseSizes.for_light_field(light_field)
    return thesis_depth(light_field, params, sizes, key=jax.random.key(0)).disparity


def sweep(light_field: LightField) -> jax.Array:
    """The plane sweep of the crosshair, over a measured range where none is given."""
    return plane_sweep(light_field, disparity_range=scene_range(light_field)).disparity


OURS = chain("ours")
EVERY = chain("ours, all views", views="all")
SWEEP = Method("plane sweep", sweep)
THESIS = Method("thesis", thesis)
# Points only, as in the thesis, and the ways to place them.
SPARSE = (
    sparse("edges only, bidirectional", side="bidirectional"),
    sparse("edges only, thesis' response"),
    sparse("edges only, reprojection", side="reprojection"),
    sparse("edges only, naive", side="naive"),
)
ABLATIONS = (
    chain("ours, quantised median", sharpening="quantised"),
    chain("ours, no sharpening", sharpening="none"),
    sparse("edges only, quantised median", side="bidirectional", sharpening="quantised"),
    sparse("edges only, no sharpening", side="bidirectional", sharpening="none"),
    sparse("edges only, unit weights", side="bidirectional", unit_weights=True),
)


def robust_loss(disparity: jax.Array, light_field: LightField, scale: float = 0.03) -> jax.Array:
    """Mean of `log(1 + (error / scale)²)` over the pixels whose truth is known; scale in px."""
    truth = light_field.truth
    if truth is None:
        raise ValueError(f"scene {light_field.name} has no ground truth to learn from.")
    error = jnp.where(truth.valid, disparity - truth.disparity, 0)
    return jnp.mean(jnp.log1p((error / scale) ** 2))


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
