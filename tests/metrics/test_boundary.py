"""Boundary precision and recall: against loops over thresholds with SciPy's distances."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces
from scipy import ndimage

from mvedge_jax.metrics import boundary_scores


def _scene(shape=(27, 34)):
    rng = np.random.default_rng(5)
    truth = np.repeat(np.repeat(rng.random((4, 5)), 7, 0), 7, 1)[: shape[0], : shape[1]]
    result = ndimage.gaussian_filter(truth, 0.8) + 0.05 * rng.normal(size=shape)
    return jnp.asarray(result), jnp.asarray(truth), jnp.asarray(rng.random(shape) < 0.95)


def _strength(disparity, mask):
    strength = np.zeros(disparity.shape)
    for axis in (0, 1):
        here = [slice(None)] * 2
        here[axis] = slice(None, -1)
        there = [slice(None)] * 2
        there[axis] = slice(1, None)
        here, there = tuple(here), tuple(there)
        jump = np.abs(disparity[there] - disparity[here]) * (mask[here] & mask[there])
        strength[here] = np.maximum(strength[here], jump)
    return strength


def _within(target, tolerance):
    if not target.any():
        return np.zeros(target.shape, bool)
    return ndimage.distance_transform_edt(~target) <= tolerance + 1e-9


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


def test_blur_and_noise_cost():
    _, truth, _ = _scene()
    exact = boundary_scores(truth, truth, truth_threshold=0.1)
    assert exact.auc == 1
    blurred = jnp.asarray(ndimage.gaussian_filter(np.asarray(truth), 2.0))
    noisy = truth + 0.2 * np.random.default_rng(0).normal(size=truth.shape)
    for worse in (blurred, noisy):
        scores = boundary_scores(worse, truth)
        assert scores.mean_f1 < exact.mean_f1
        assert scores.auc < 0.9


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_never_improve_a_score(value):
    result, truth, _ = _scene()
    before = boundary_scores(result, truth)
    for seed in range(5):
        hole = np.random.default_rng(seed).random(result.shape) < 0.03
        after = boundary_scores(jnp.asarray(np.where(hole, value, result)), truth)
        assert (after.precision <= before.precision).all()
        assert (after.recall <= before.recall).all()
        assert after.mean_f1 < before.mean_f1
        assert after.auc < before.auc


def test_what_is_not_counted_changes_nothing():
    result, truth, mask = _scene()
    one = boundary_scores(result, truth, mask=mask, crop=2)
    spoilt = np.where(mask, result, np.nan), np.where(mask, truth, np.nan)
    spoilt[0][:2], spoilt[1][:, -2:] = 7.0, -3.0
    other = boundary_scores(jnp.asarray(spoilt[0]), jnp.asarray(spoilt[1]), mask=mask, crop=2)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_true_boundary_is_nan():
    result, truth, _ = _scene()
    assert jnp.isnan(boundary_scores(result, jnp.zeros((27, 34))).mean_f1)


def test_one_trace_and_vmap():
    result, truth, _ = _scene()
    counted, traces = count_traces(
        lambda d, t, g: boundary_scores(d, truth, thresholds=t, truth_threshold=g).auc
    )
    sweeps = jnp.array([[0.1, 0.2, 0.4], [0.05, 0.3, 0.5]])
    levels = jnp.array([0.1, 0.3])
    loop = [counted(result, sweep, level) for sweep, level in zip(sweeps, levels, strict=True)]
    assert traces() == 1
    mapped = jax.vmap(counted, (None, 0, 0))(result, sweeps, levels)
    np.testing.assert_allclose(mapped, loop)


def test_single_precision_stays_single():
    result, truth, _ = _scene()
    single = boundary_scores(result.astype(jnp.float32), truth.astype(jnp.float32))
    double = boundary_scores(result, truth)
    assert {leaf.dtype for leaf in jax.tree.leaves(single)} == {jnp.dtype(jnp.float32)}
    np.testing.assert_allclose(single.mean_f1, double.mean_f1, atol=2e-3)


def test_bad_input_says_what_is_wrong():
    with pytest.raises(ValueError, match="`truth` must have the shape"):
        inspect.unwrap(boundary_scores)(jnp.zeros((4, 5)), jnp.zeros((5, 5)))
