"""Depth errors: against NumPy, under masks, crops and values that are not finite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient

from mvedge_jax.metrics import depth_scores, edge_band
from mvedge_jax.metrics.depth import bad_pixels, error_percentile, mae, mse, q25


def bad(disparity, truth, **options):
    return bad_pixels(disparity, truth, 0.5, **options)


# Metric, and the same in NumPy on the absolute errors of the counted pixels.
ORACLES = {
    mse: lambda e: 100 * np.mean(e**2),
    mae: np.mean,
    q25: lambda e: 100 * np.percentile(e, 25),
    bad: lambda e: 100 * (e > 0.5).mean(),
}


def _maps(shape=(13, 18)):
    rng = np.random.default_rng(3)
    disparity, truth = rng.normal(size=(2, *shape))
    return jnp.asarray(disparity), jnp.asarray(truth), jnp.asarray(rng.random(shape) < 0.7)


@pytest.mark.parametrize("metric", ORACLES, ids=lambda metric: metric.__name__)
@pytest.mark.parametrize("crop", [0, 3])
def test_agrees_with_numpy(metric, crop):
    disparity, truth, mask = _maps()
    truth = truth.at[4, 5].set(jnp.nan).at[6, 7].set(jnp.inf)
    inner = np.s_[crop : 13 - crop, crop : 18 - crop]
    keep = (np.asarray(mask) & np.isfinite(truth))[inner]
    error = np.abs(np.asarray(disparity - truth)[inner][keep])
    found = metric(disparity, truth, mask=mask, crop=crop)
    np.testing.assert_allclose(found, ORACLES[metric](error), rtol=1e-12)


@pytest.mark.parametrize("metric", [mse, mae])
def test_gradients_match_differences_and_ignore_masked_pixels(metric):
    disparity, truth, mask = _maps((5, 7))
    check_gradient(
        lambda d: metric(d, truth, mask=mask), disparity, rtol=1e-7, key=jax.random.key(0)
    )
    gradient = jax.grad(metric)(jnp.where(mask, disparity, jnp.nan), truth, mask=mask)
    assert (gradient[~mask] == 0).all()
    assert jnp.isfinite(gradient).all()


@pytest.mark.parametrize("percent", [0.0, 12.5, 50.0, 99.0, 100.0])
def test_percentile_with_infinite_errors(percent):
    disparity, truth, mask = _maps()
    disparity = disparity.at[:3].set(jnp.nan)
    error = np.where(np.isfinite(disparity), np.abs(np.asarray(disparity - truth)), np.inf)
    ordered = np.sort(error[np.asarray(mask)])
    rank = percent / 100 * (len(ordered) - 1)
    low, high = ordered[int(rank)], ordered[min(int(rank) + 1, len(ordered) - 1)]
    with np.errstate(invalid="ignore"):
        expected = low if rank == int(rank) else low + (rank - int(rank)) * (high - low)
    expected = np.inf if np.isnan(expected) else expected
    np.testing.assert_allclose(error_percentile(disparity, truth, percent, mask=mask), expected)


def test_scores_are_the_single_metrics():
    disparity, truth, mask = _maps()
    disparity = disparity.at[2, 3].set(jnp.nan)
    mask = mask.at[2, 3].set(True)
    scores = depth_scores(disparity, truth, mask=mask, crop=1, edge_threshold=1.5, edge_radius=1.0)
    band = edge_band(truth, mask=mask, threshold=1.5, radius=1.0)
    assert 0 < band.sum() < mask.sum()
    assert scores.mse == jnp.inf
    assert scores.not_finite == 1
    assert int(scores.pixels) == int(mask[1:-1, 1:-1].sum())
    for found, metric, counted in (
        (scores.q25, q25, mask),
        (scores.bad_07, lambda d, t, **k: bad_pixels(d, t, 0.07, **k), mask),
        (scores.edge_mse, mse, band),
        (scores.edge_bad_07, lambda d, t, **k: bad_pixels(d, t, 0.07, **k), band),
    ):
        np.testing.assert_allclose(found, metric(disparity, truth, mask=counted, crop=1))
