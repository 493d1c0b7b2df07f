"""Boundary precision and recall, and the band around edges: against SciPy's distances."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.metrics import boundary_scores, edge_band


def _blocks(shape):
    rng = np.random.default_rng(5)
    return np.repeat(np.repeat(rng.random((4, 5)), 7, 0), 7, 1)[: shape[0], : shape[1]]


def _scene(shape=(27, 34)):
    rng, truth = np.random.default_rng(6), _blocks(shape)
    result = ndimage.gaussian_filter(truth, 0.8) + 0.05 * rng.normal(size=shape)
    return jnp.asarray(result), jnp.asarray(truth), jnp.asarray(rng.random(shape) < 0.95)


def _strength(disparity, mask):
    """The largest step to the right or lower neighbor, in plain loops."""
    strength = np.zeros(disparity.shape)
    for y, x in np.ndindex(disparity.shape):
        for b, a in ((y, x + 1), (y + 1, x)):
            if b < disparity.shape[0] and a < disparity.shape[1] and mask[y, x] and mask[b, a]:
                strength[y, x] = max(strength[y, x], abs(disparity[y, x] - disparity[b, a]))
    return strength


def _within(target, tolerance):
    if not target.any():
        return np.zeros(target.shape, bool)
    return ndimage.distance_transform_edt(~target) <= tolerance + 1e-9


@pytest.mark.parametrize(("shape", "radius"), [((23, 31), 0.0), ((23, 31), 3.7), ((1, 19), 1.5)])
def test_band_is_a_distance_from_the_edges(shape, radius):
    truth = _blocks(shape)
    band = edge_band(jnp.asarray(truth), threshold=0.25, radius=radius)
    edges = _strength(truth, np.ones(shape, bool)) > 0.25
    np.testing.assert_array_equal(band, _within(edges, radius))
    assert 0 < band.sum() < band.size


def test_unknown_and_masked_pixels_make_no_edges():
    truth, mask = np.zeros((9, 9)), np.ones((9, 9), bool)
    truth[4, 4], truth[2, 2], mask[2, 2] = np.nan, 5.0, False
    band = np.asarray(edge_band(jnp.asarray(truth), radius=1.0))
    assert band.sum() == 10  # three edge pixels in an L, widened by 1 px
    masked = edge_band(jnp.asarray(truth), mask=jnp.asarray(mask), radius=1.0)
    assert not np.asarray(masked).any()


@pytest.mark.parametrize("tolerance", [1.5, 2.0])
def test_agrees_with_brute_force(tolerance):
    result, truth, mask = _scene()
    scores = boundary_scores(result, truth, mask=mask, truth_threshold=0.25, tolerance=tolerance)
    thresholds = np.geomspace(0.02, 2.0, 41)
    np.testing.assert_allclose(scores.thresholds, thresholds)
    strength = _strength(np.asarray(result), np.asarray(mask))
    boundary = _strength(np.asarray(truth), np.asarray(mask)) > 0.25
    for i, threshold in enumerate(thresholds):
        detected = strength > threshold
        precision = _within(boundary, tolerance)[detected].mean() if detected.any() else 1.0
        recall = _within(detected, tolerance)[boundary].mean()
        np.testing.assert_allclose(scores.precision[i], precision, rtol=1e-12)
        np.testing.assert_allclose(scores.recall[i], recall, rtol=1e-12)
        np.testing.assert_allclose(scores.f1[i], 2 * precision * recall / (precision + recall))
    assert scores.precision[-1] == 1  # nothing is detected
    assert scores.recall[-1] == 0
    precision, recall = np.asarray(scores.precision), np.asarray(scores.recall)
    fine = (np.arange(200000) + 0.5) / 200000
    best = np.where(recall[:, None] >= fine, precision[:, None], 0).max(0)
    np.testing.assert_allclose(scores.auc, best.mean(), atol=1e-4)
    np.testing.assert_allclose(scores.mean_f1, scores.f1.mean())
    assert scores.peak_f1 == scores.f1.max()
    assert 0 < scores.peak_f1 < 1


def test_one_pixel_aside_is_right_and_three_are_not():
    x = np.arange(34) * np.ones((27, 1))
    step, one, three = (jnp.asarray(x < edge, float) for edge in (17, 18, 20))
    assert boundary_scores(one, step).auc == 1
    aside = boundary_scores(three, step)
    assert aside.peak_f1 == aside.auc == 0
    assert jnp.isnan(boundary_scores(step, 0 * step).mean_f1)  # there is no true boundary
