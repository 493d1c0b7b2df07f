"""Precision and recall of depth boundaries (Thesis 6.2.4, Fig. 6.4 and Tab. 6.3)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy

from ._region import check_maps, counted_pixels, cropped, depth_steps, disc_maximum


class BoundaryScores(NamedTuple):
    """Depth boundaries of one map against the truth's; see `boundary_scores`.

    Attributes:
        thresholds: Jumps from which on a pixel of the map was called a boundary, `[t]`, px.
        precision: Share of those pixels that lie on a true boundary, `[t]`.
        recall: Share of the true boundary that was found, `[t]`.
        f1: Harmonic mean of precision and recall, `[t]`.
        mean_f1: Mean of `f1` over the thresholds.
        peak_f1: Largest `f1`.
        auc: Area under the precision-recall curve.
    """

    thresholds: Float[Array, " t"]
    precision: Float[Array, " t"]
    recall: Float[Array, " t"]
    f1: Float[Array, " t"]
    mean_f1: Float[Array, ""]
    peak_f1: Float[Array, ""]
    auc: Float[Array, ""]


def default_thresholds() -> Float[np.ndarray, " t"]:
    """The 41 thresholds of `boundary_scores`: 0.02 to 2 px in equal ratios (20 per decade)."""
    return np.geomspace(0.02, 2.0, 41)


@accepts_numpy
def boundary_scores(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
    thresholds: Float[Array, " t"] | None = None,
    truth_threshold: float | Float[Array, ""] = 0.1,
    tolerance: float = 1.5,
) -> BoundaryScores:
    r"""Scores where a disparity map puts its depth boundaries.

    The strength of a boundary at a pixel is the larger of the absolute jumps of disparity to its
    right and lower neighbor. The true boundary is where the truth's strength exceeds
    `truth_threshold`, the detected one where the map's exceeds a threshold $t$. A match is within
    `tolerance` px (Euclidean; 1.5 px is the 3x3 neighborhood; not one-to-one):

    - precision: share of the detected pixels that match a true one (1 if nothing was detected);
    - recall: share of the true pixels that match a detected one;
    - F1: harmonic mean, 0 where both are 0;
    - area: $\int_0^1 \max\{P(t) : R(t) \ge r\}\, dr$, without extrapolation beyond the largest
      recall.

    Beyond the jumps of the scene nothing is left to detect, so that even the truth's own mean F1 is
    below 1. The thesis does not print its tolerance and thresholds: compare with Tab. 6.3 in order,
    not in digits. A jump to or from a disparity that is not finite is detected at every threshold
    and matches nothing.

    Args:
        disparity: The map to score, `[y, x]`, px per view step.
        truth: Ground truth, `[y, x]`, px per view step; NaN where unknown.
        mask: Pixels that count, `[y, x]`; all by default. A jump counts if both its ends do.
        crop: Pixels to leave out on each side, static.
        thresholds: The sweep, `[t]`, px per view step, in any order, traced; by default 41 values
            from 0.02 to 2 px in equal ratios.
        truth_threshold: Smallest jump of the true boundary, px per view step, traced.
        tolerance: Largest distance of a match, px, static.

    Returns:
        The curve and its summaries, NaN if the truth has no depth boundary. Not differentiable.

    Raises:
        ValueError: if the shapes differ or the crop leaves nothing.

    Source: Thesis 6.2.4, Fig. 6.4 and Tab. 6.3; the definitions above are this project's.

    Example:
        >>> import jax.numpy as jnp
        >>> truth = jnp.zeros((8, 32)).at[:, :16].set(1.0)
        >>> boundary_scores(truth, truth).auc.item()
        1.0
    """
    check_maps(disparity, truth, mask, crop)
    dtype = disparity.dtype
    return _boundary_scores(
        disparity,
        truth.astype(dtype),
        jnp.ones(disparity.shape, bool) if mask is None else mask,
        jnp.asarray(default_thresholds() if thresholds is None else thresholds, dtype),
        jnp.asarray(truth_threshold, dtype),
        crop=crop,
        tolerance=tolerance,
    )


def _scores(
    disparity, truth, mask, thresholds, truth_threshold, *, crop, tolerance
) -> BoundaryScores:
    counted = cropped(counted_pixels(truth, mask), crop)
    strength = depth_steps(cropped(disparity, crop), counted)
    spoilt = jnp.isinf(strength)
    strength = jnp.where(spoilt, 0, strength)
    boundary = depth_steps(cropped(truth, crop), counted) > truth_threshold
    # The sweep needs one dilation each way: the strongest jump near a true pixel is what decides
    # from which threshold on it is found.
    near_truth = disc_maximum(boundary.astype(strength.dtype), tolerance) > 0
    strongest = disc_maximum(strength, tolerance)

    def count(pixels: Array) -> Array:
        return pixels.sum(dtype=jnp.int32).astype(strength.dtype)

    true_pixels = count(boundary)

    def at(threshold: Array) -> tuple[Array, Array]:
        detected = strength > threshold
        wrong = count(spoilt) + count(detected & ~near_truth)
        right = count(detected & near_truth)
        precision = jnp.where(right + wrong > 0, right / jnp.maximum(right + wrong, 1), 1)
        return precision, count(boundary & (strongest > threshold)) / true_pixels

    precision, recall = jax.lax.map(at, thresholds)
    total = precision + recall
    f1 = jnp.where(total > 0, 2 * precision * recall / jnp.where(total > 0, total, 1), 0)
    f1 = jnp.where(true_pixels > 0, f1, jnp.nan)
    return BoundaryScores(
        thresholds, precision, recall, f1, f1.mean(), f1.max(), _area(precision, recall)
    )


def _area(precision: Float[Array, " t"], recall: Float[Array, " t"]) -> Float[Array, ""]:
    order = jnp.argsort(recall)
    envelope = jax.lax.cummax(precision[order], reverse=True)
    return jnp.sum(envelope * jnp.diff(recall[order], prepend=jnp.zeros(1, recall.dtype)))


_boundary_scores = jax.jit(_scores, static_argnames=("crop", "tolerance"))
