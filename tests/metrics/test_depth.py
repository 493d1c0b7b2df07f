"""Depth errors: against NumPy, under masks, crops and values that are not finite."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces, shared_data

from mvedge_jax.datasets import read_pfm
from mvedge_jax.metrics import depth_scores, edge_band
from mvedge_jax.metrics.depth import bad_pixels, error_percentile, mae, mse, q25

# Name, metric, and the same in NumPy on the absolute errors of the counted pixels.
METRICS = [
    ("mse", mse, lambda e: 100 * np.mean(e**2)),
    ("mae", mae, np.mean),
    ("q25", q25, lambda e: 100 * np.percentile(e, 25)),
    (
        "bad",
        lambda d, t, **k: bad_pixels(d, t, 0.5, **k),
        lambda e: 100 * (e > 0.5).mean(),
    ),
]
each_metric = pytest.mark.parametrize(
    ("metric", "oracle"), [m[1:] for m in METRICS], ids=[m[0] for m in METRICS]
)


def _maps(shape=(13, 18), dtype=np.float64):
    rng = np.random.default_rng(3)
    disparity, truth = rng.normal(size=(2, *shape)).astype(dtype)
    return jnp.asarray(disparity), jnp.asarray(truth), jnp.asarray(rng.random(shape) < 0.7)


@each_metric
@pytest.mark.parametrize("crop", [0, 3])
def test_agrees_with_numpy(metric, oracle, crop):
    disparity, truth, mask = _maps()
    truth = truth.at[4, 5].set(jnp.nan).at[6, 7].set(jnp.inf)
    inner = np.s_[crop : 13 - crop, crop : 18 - crop]
    keep = (np.asarray(mask) & np.isfinite(truth))[inner]
    error = np.abs(np.asarray(disparity - truth)[inner][keep])
    np.testing.assert_allclose(
        metric(disparity, truth, mask=mask, crop=crop), oracle(error), rtol=1e-12
    )


@each_metric
def test_what_is_not_counted_changes_nothing(metric, oracle):
    disparity, truth, mask = _maps()
    spoilt = jnp.where(mask, disparity, jnp.nan)
    assert metric(disparity, truth, mask=mask) == metric(spoilt, truth, mask=mask)
    assert metric(disparity, truth, mask=mask) == metric(disparity, jnp.where(mask, truth, jnp.nan))
    ring = disparity.at[0].set(jnp.nan).at[:, -1].set(jnp.inf)
    assert metric(disparity, truth, crop=1) == metric(ring, truth, crop=1)


@each_metric
@pytest.mark.parametrize("value", [jnp.nan, jnp.inf, -jnp.inf])
def test_values_that_are_not_finite_never_improve_a_score(metric, oracle, value):
    disparity, truth, mask = _maps()
    before = metric(disparity, truth, mask=mask)
    for seed in range(4):
        hole = jnp.asarray(np.random.default_rng(seed).random(disparity.shape) < 0.1)
        after = metric(jnp.where(hole, value, disparity), truth, mask=mask)
        assert after >= before
    worst = metric(jnp.full_like(disparity, value), truth, mask=mask)
    assert worst == (100 if oracle is METRICS[3][2] else jnp.inf)


@each_metric
def test_nothing_to_score_is_nan_not_zero(metric, oracle):
    disparity, truth, mask = _maps()
    assert jnp.isnan(metric(disparity, truth, mask=jnp.zeros_like(mask)))


@each_metric
def test_one_trace_and_vmap(metric, oracle):
    disparity, truth, mask = _maps()
    counted, traces = count_traces(metric)
    stack = jnp.stack([disparity, 0.5 * disparity, disparity + 1])
    loop = jnp.stack([counted(d, truth, mask=mask) for d in stack])
    assert traces() == 1
    np.testing.assert_allclose(jax.vmap(lambda d: metric(d, truth, mask=mask))(stack), loop)


@pytest.mark.parametrize("metric", [mse, mae])
def test_gradients_match_differences_and_ignore_masked_pixels(metric):
    disparity, truth, mask = _maps((5, 7))
    check_gradient(
        lambda d: metric(d, truth, mask=mask), disparity, rtol=1e-7, key=jax.random.key(0)
    )
    gradient = jax.grad(metric)(jnp.where(mask, disparity, jnp.nan), truth, mask=mask)
    assert (gradient[~mask] == 0).all()
    assert jnp.isfinite(gradient).all()


def test_bad_pixels_takes_traced_thresholds():
    disparity, truth, mask = _maps()
    thresholds = jnp.array([0.0, 0.3, 1.0, 10.0])
    curve = jax.jit(jax.vmap(lambda t: bad_pixels(disparity, truth, t, mask=mask)))(thresholds)
    error = np.abs(np.asarray(disparity - truth))[np.asarray(mask)]
    np.testing.assert_allclose(curve, [100 * (error > float(t)).mean() for t in thresholds])


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
    np.testing.assert_allclose(scores.q25, q25(disparity, truth, mask=mask, crop=1))
    np.testing.assert_allclose(scores.bad_07, bad_pixels(disparity, truth, 0.07, mask=mask, crop=1))
    np.testing.assert_allclose(scores.edge_mse, mse(disparity, truth, mask=band, crop=1))
    np.testing.assert_allclose(
        scores.edge_bad_07, bad_pixels(disparity, truth, 0.07, mask=band, crop=1)
    )


def test_single_precision_is_enough_for_the_printed_digits():
    disparity, truth, mask = _maps((200, 211))
    single = depth_scores(disparity.astype(jnp.float32), truth.astype(jnp.float32), mask=mask)
    double = depth_scores(disparity, truth, mask=mask)
    assert single.mse.dtype == jnp.float32
    for ours, exact in zip(single, double, strict=True):
        np.testing.assert_allclose(ours, exact, rtol=2e-5)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((jnp.zeros((4, 5)), jnp.zeros((5, 4))), {}, "`truth` must have the shape"),
        ((jnp.zeros((4, 5)), jnp.zeros((4, 5))), {"mask": jnp.ones((4, 4), bool)}, "`mask` must"),
        ((jnp.zeros((4, 5)), jnp.zeros((4, 5))), {"crop": 2}, "`crop` must"),
        ((jnp.zeros((4, 5)), jnp.zeros((4, 5))), {"crop": -1}, "`crop` must"),
    ],
)
def test_bad_input_says_what_is_wrong(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(mse)(*arguments, **options)  # as users call it: without the type checker


# Published: the benchmark's own tables, cotton, 15 px cropped on each side.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "published"),
    [
        ("spo", {"mse": "1.313", "bad_01": "69.06", "bad_03": "13.71", "bad_07": "2.594"}),
        ("fastlfnet", {"mse": "0.322", "bad_01": "49.34", "bad_03": "6.785", "bad_07": "0.714"}),
    ],
)
def test_published_results_get_their_published_scores(method, published):
    result = read_pfm(shared_data("peer_results", method, "cotton.pfm"))
    truth = read_pfm(shared_data("hci", "cotton", "gt_disp_lowres.pfm"))
    scores = depth_scores(jnp.asarray(result), jnp.asarray(truth), crop=15)
    for name, figure in published.items():
        digits = len(figure.partition(".")[2])
        assert f"{float(getattr(scores, name)):.{digits}f}" == figure, name
