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


@pytest.mark.parametrize(
    ("scale", "within"), [(1.0, [0.683, 0.954, 0.997]), (0.5, [0.383, 0.683, 0.866])]
)
def test_true_errors_lie_on_the_diagonal_and_small_ones_beside_it(scale, within):
    found = calibration(*normal_errors(scale), groups=4)
    np.testing.assert_allclose(found.within, within, atol=0.02)
    np.testing.assert_allclose(found.found, found.predicted / scale, rtol=0.12)
    assert (np.diff(found.predicted) > 0).all()


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
    # The order of the true errors leaves no area.
    known = calibration(disparity, jnp.abs(disparity - truth) + 1e-9, truth)
    assert abs(float(known.ause)) < 1e-5


def test_what_is_masked_cropped_or_unknown_does_not_count():
    disparity, sigma, truth = normal_errors()
    mask = jnp.ones(SHAPE, bool).at[:, :10].set(False)
    expected = calibration(disparity[2:-2, 10:-2], sigma[2:-2, 10:-2], truth[2:-2, 10:-2])
    spoilt = disparity.at[:, :10].set(jnp.nan), sigma.at[:, :10].set(-1)
    found = calibration(*spoilt, truth.at[:, :10].set(jnp.nan), mask=mask, crop=2)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)
    assert float(calibration(disparity, jnp.full_like(sigma, jnp.inf), truth).within[0]) == 1


def test_few_pixels_make_few_groups_and_none_make_nan():
    disparity, sigma, truth = normal_errors()
    found = calibration(disparity[:2, :2], sigma[:2, :2], truth[:2, :2])
    assert found.predicted.shape == found.sparsified.shape == (4,)
    nothing = calibration(disparity, sigma, truth, mask=jnp.zeros(SHAPE, bool))
    assert np.isnan([*nothing.within, nothing.ause]).all()
    assert nothing.predicted.size == 0
