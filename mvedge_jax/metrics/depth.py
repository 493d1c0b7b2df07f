"""Errors of a disparity map against ground truth (Thesis 6.2.3, Tables 6.1 and 7.1)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy

from ._region import check_maps, counted_pixels, cropped, edge_band


def _errors(
    disparity: Array, truth: Array, mask: Array | None, crop: int
) -> tuple[Float[Array, "i j"], Bool[Array, "i j"]]:
    """Signed error (infinite where the map is not finite, 0 where not counted), and counted."""
    check_maps(disparity, truth, mask, crop)
    truth = truth.astype(disparity.dtype)
    counted = counted_pixels(truth, mask)
    finite = jnp.isfinite(disparity)
    error = jnp.where(finite & counted, disparity - truth, 0)
    error = jnp.where(counted & ~finite, jnp.inf, error)
    return cropped(error, crop), cropped(counted, crop)


def _mean(values: Float[Array, "i j"], counted: Bool[Array, "i j"]) -> Float[Array, ""]:
    # Rows first: a single float32 accumulator over a million pixels would lose digits.
    number = counted.sum().astype(values.dtype)
    total = values.sum(1).sum()
    return jnp.where(number > 0, total / jnp.maximum(number, 1), jnp.nan)


@accepts_numpy
def mse(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
) -> Float[Array, ""]:
    """Mean squared error x 100.

    Like every depth metric, it counts the pixels where the mask is set and the truth is finite. A
    disparity that is not finite there counts as an infinite error: it never improves a score.

    Args:
        disparity: The map to score, `[y, x]`, px per view step.
        truth: Ground truth, `[y, x]`, px per view step; NaN where unknown.
        mask: Pixels that count, `[y, x]`; all by default. `edge_band` makes one.
        crop: Pixels to leave out on each side, static: 15 in the HCI benchmark, 0 in the thesis.

    Returns:
        100 x px², NaN if no pixel counts. Differentiable with respect to `disparity`.

    Raises:
        ValueError: if the shapes differ or the crop leaves nothing.

    Source: Thesis 6.2.3.

    Example:
        >>> import jax.numpy as jnp
        >>> mse(jnp.array([[0.1, 0.0]]), jnp.array([[0.0, jnp.nan]])).round(6).item()
        1.0
    """
    error, counted = _errors(disparity, truth, mask, crop)
    return 100 * _mean(error**2, counted)


@accepts_numpy
def mae(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
) -> Float[Array, ""]:
    """Mean absolute error.

    Args:
        disparity: As for `mse`.
        truth: As for `mse`.
        mask: As for `mse`.
        crop: As for `mse`.

    Returns:
        px per view step; infinite if a counted disparity is not finite, NaN if no pixel counts.
        Differentiable with respect to `disparity`.
    """
    error, counted = _errors(disparity, truth, mask, crop)
    return _mean(jnp.abs(error), counted)


@accepts_numpy
def error_percentile(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    percent: float | Float[Array, ""],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
) -> Float[Array, ""]:
    """Percentile of the absolute error, interpolated linearly between order statistics.

    Args:
        disparity: As for `mse`.
        truth: As for `mse`.
        percent: Which percentile, 0..100, traced.
        mask: As for `mse`.
        crop: As for `mse`.

    Returns:
        px per view step. A disparity that is not finite ranks last. NaN if no pixel counts.
    """
    error, counted = _errors(disparity, truth, mask, crop)
    ordered = jnp.sort(jnp.where(counted, jnp.abs(error), jnp.inf).ravel())
    number = counted.sum(dtype=jnp.int32)
    rank = jnp.asarray(percent, ordered.dtype) / 100 * (number - 1).astype(ordered.dtype)
    below = jnp.clip(jnp.floor(rank), 0).astype(jnp.int32)
    above = jnp.clip(below + 1, max=jnp.maximum(number - 1, 0))
    low, high = ordered[below], ordered[above]
    fraction = rank - below.astype(rank.dtype)
    between = jnp.isfinite(high) & (fraction > 0)
    value = jnp.where(between, low + fraction * (jnp.where(between, high, low) - low), low)
    value = jnp.where(~jnp.isfinite(high) & (fraction > 0), high, value)
    return jnp.where(number > 0, value, jnp.nan)


@accepts_numpy
def q25(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
) -> Float[Array, ""]:
    """25th percentile of the absolute error x 100.

    Args:
        disparity: As for `mse`.
        truth: As for `mse`.
        mask: As for `mse`.
        crop: As for `mse`.

    Returns:
        100 x px per view step, NaN if no pixel counts.

    Source: Thesis 6.2.3 and the HCI benchmark.
    """
    return 100 * error_percentile(disparity, truth, 25.0, mask=mask, crop=crop)


@accepts_numpy
def bad_pixels(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    threshold: float | Float[Array, ""],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
) -> Float[Array, ""]:
    """Share of pixels whose absolute error exceeds a threshold: BadPix(t).

    Args:
        disparity: As for `mse`.
        truth: As for `mse`.
        threshold: Largest error of a good pixel, px per view step, traced; `jax.vmap` over it
            gives a curve. The benchmark uses 0.01, 0.03 and 0.07.
        mask: As for `mse`.
        crop: As for `mse`.

    Returns:
        Percent of the counted pixels; a disparity that is not finite is bad. NaN if no pixel
        counts. Not differentiable (its gradient is zero).

    Source: Thesis 7.2.3, Table 7.1, and the HCI benchmark.

    Example:
        >>> import jax.numpy as jnp
        >>> bad_pixels(jnp.array([[0.0, 0.05], [0.1, jnp.nan]]), jnp.zeros((2, 2)), 0.07).item()
        50.0
    """
    error, counted = _errors(disparity, truth, mask, crop)
    bad = counted & (jnp.abs(error) > jnp.asarray(threshold, error.dtype))
    return 100 * _mean(bad.astype(error.dtype), counted)


class DepthScores(NamedTuple):
    """The depth metrics of one map; see `depth_scores`.

    Attributes:
        mse: Mean squared error x 100, px².
        mae: Mean absolute error, px.
        q25: 25th percentile of the absolute error x 100, px.
        bad_01: Percent of errors above 0.01 px.
        bad_03: Percent of errors above 0.03 px.
        bad_07: Percent of errors above 0.07 px.
        edge_mse: `mse` in the band around depth edges; NaN without depth edges.
        edge_bad_07: `bad_07` in the band around depth edges.
        not_finite: How many counted disparities are NaN or infinite.
        pixels: How many pixels counted.
    """

    mse: Float[Array, ""]
    mae: Float[Array, ""]
    q25: Float[Array, ""]
    bad_01: Float[Array, ""]
    bad_03: Float[Array, ""]
    bad_07: Float[Array, ""]
    edge_mse: Float[Array, ""]
    edge_bad_07: Float[Array, ""]
    not_finite: Int[Array, ""]
    pixels: Int[Array, ""]


@accepts_numpy
def depth_scores(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
    edge_threshold: float | Float[Array, ""] = 0.1,
    edge_radius: float = 5.0,
) -> DepthScores:
    """Scores a disparity map by every depth metric that the benchmark and the thesis use.

    Args:
        disparity: The map to score, `[y, x]`, px per view step.
        truth: Ground truth, `[y, x]`, px per view step; NaN where unknown.
        mask: Pixels that count, `[y, x]`; all by default.
        crop: Pixels to leave out on each side, static: 15 in the HCI benchmark, 0 in the thesis.
        edge_threshold: Smallest jump of a depth edge, px per view step, traced.
        edge_radius: Half width of the band around depth edges, px, static.

    Returns:
        The scores; `DepthScores` says which.

    Raises:
        ValueError: if the shapes differ or the crop leaves nothing.

    Source: Thesis 6.2.3, Tables 6.1 and 7.1.
    """
    check_maps(disparity, truth, mask, crop)
    return _depth_scores(
        disparity,
        truth,
        jnp.ones(disparity.shape, bool) if mask is None else mask,
        jnp.asarray(edge_threshold, disparity.dtype),
        crop=crop,
        edge_radius=edge_radius,
    )


def _scores(disparity, truth, mask, edge_threshold, *, crop, edge_radius) -> DepthScores:
    error, counted = _errors(disparity, truth, mask, crop)
    band = edge_band(truth, mask=mask, threshold=edge_threshold, radius=edge_radius)
    maps = (disparity, truth)
    return DepthScores(
        mse=mse(*maps, mask=mask, crop=crop),
        mae=mae(*maps, mask=mask, crop=crop),
        q25=q25(*maps, mask=mask, crop=crop),
        bad_01=bad_pixels(*maps, 0.01, mask=mask, crop=crop),
        bad_03=bad_pixels(*maps, 0.03, mask=mask, crop=crop),
        bad_07=bad_pixels(*maps, 0.07, mask=mask, crop=crop),
        edge_mse=mse(*maps, mask=band, crop=crop),
        edge_bad_07=bad_pixels(*maps, 0.07, mask=band, crop=crop),
        not_finite=jnp.isinf(error).sum(dtype=jnp.int32),
        pixels=counted.sum(dtype=jnp.int32),
    )


_depth_scores = jax.jit(_scores, static_argnames=("crop", "edge_radius"))
