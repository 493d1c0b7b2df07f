"""Calibration: standard errors that are true, too small, and of no use."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.metrics import calibration

SHAPE = (60, 80)


def normal_errors(scale=1.0):
    """A map whose errors are normal, with standard errors `scale` times too large."""
    keys = jax.random.split(jax.random.key(0))
    sigma = 0.01 * jnp.exp(jax.random.uniform(keys[0], SHAPE, minval=-2.0, maxval=2.0))
    disparity = sigma * jax.random.normal(keys[1], SHAPE)
    return disparity, scale * sigma, jnp.zeros(SHAPE)


def test_true_errors_lie_on_the_diagonal():
    found = calibration(*normal_errors(), groups=4)
    np.testing.assert_allclose(found.within, [0.683, 0.954, 0.997], atol=0.02)
    np.testing.assert_allclose(found.found, found.predicted, rtol=0.12)
    assert (np.diff(found.predicted) > 0).all()


def test_errors_that_are_too_small_do_not():
    found = calibration(*normal_errors(0.5), groups=4)
    np.testing.assert_allclose(found.within[1], 0.683, atol=0.02)
    assert (found.found > 1.7 * found.predicted).all()


def test_sparsification_equals_a_loop():
    disparity, sigma, truth = normal_errors()
    found = calibration(disparity, sigma, truth, groups=8)
    size, spread = np.abs(np.asarray(disparity - truth)).ravel(), np.asarray(sigma).ravel()
    for share, ours, best in zip(found.left_out, found.sparsified, found.oracle, strict=True):
        count = size.size - round(float(share) * size.size)
        for key, value in ((spread, ours), (size, best)):
            kept = sorted(range(size.size), key=lambda i, key=key: key[i])[:count]
            np.testing.assert_allclose(value, size[kept].mean() / size.mean(), rtol=1e-4)
    np.testing.assert_allclose(found.ause, np.mean(found.sparsified - found.oracle), rtol=1e-5)


def test_the_order_of_the_truth_leaves_no_area():
    disparity, _, truth = normal_errors()
    found = calibration(disparity, jnp.abs(disparity - truth) + 1e-9, truth)
    assert abs(float(found.ause)) < 1e-5


def test_what_is_masked_cropped_or_unknown_does_not_count():
    disparity, sigma, truth = normal_errors()
    mask = jnp.ones(SHAPE, bool).at[:, :10].set(False)
    expected = calibration(disparity[2:-2, 10:-2], sigma[2:-2, 10:-2], truth[2:-2, 10:-2])
    spoilt = disparity.at[:, :10].set(jnp.nan), sigma.at[:, :10].set(-1)
    found = calibration(*spoilt, truth.at[:, :10].set(jnp.nan), mask=mask, crop=2)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_is_not_known_is_within():
    disparity, sigma, truth = normal_errors()
    assert float(calibration(disparity, jnp.full_like(sigma, jnp.inf), truth).within[0]) == 1


def test_few_pixels_make_few_groups_and_none_make_nan():
    disparity, sigma, truth = normal_errors()
    found = calibration(disparity[:2, :2], sigma[:2, :2], truth[:2, :2])
    assert found.predicted.shape == found.sparsified.shape == (4,)
    nothing = calibration(disparity, sigma, truth, mask=jnp.zeros(SHAPE, bool))
    assert np.isnan([*nothing.within, nothing.ause]).all()
    assert nothing.predicted.size == 0


@pytest.mark.parametrize(
    ("error", "groups", "message"),
    [
        (jnp.zeros(SHAPE), 20, "`error` must be positive; 4800 of 4800"),
        (jnp.full(SHAPE, jnp.nan), 20, "`error` must be positive"),
        (jnp.ones((3, 3)), 20, "`error` must have the shape of `disparity`"),
        (jnp.ones(SHAPE), 0, "`groups` must be at least 1, got 0"),
    ],
)
def test_mistakes_are_named(error, groups, message):
    with pytest.raises(ValueError, match=message):
        calibration(jnp.zeros(SHAPE), error, jnp.zeros(SHAPE), groups=groups)


@pytest.mark.parametrize("value", [jnp.nan, jnp.inf])
def test_a_disparity_that_is_no_number_is_named(value):
    disparity, truth = jnp.zeros(SHAPE).at[3, 4].set(value), jnp.zeros(SHAPE)
    with pytest.raises(ValueError, match="`disparity` must be finite; 1 of 4800"):
        calibration(disparity, jnp.ones(SHAPE), truth)
    mask = jnp.ones(SHAPE, bool).at[3, 4].set(False)
    assert float(calibration(disparity, jnp.ones(SHAPE), truth, mask=mask).within[0]) == 1
