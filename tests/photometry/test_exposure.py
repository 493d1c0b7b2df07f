"""Brightness of the views: known gains and exposures are recovered and taken out."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from photometry.scenes import changed, cross_gains, exposure_along, rough_exposure, textured

from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.brightness import Brightness, expose

FLAT = jnp.full((96, 112), 0.5, jnp.float32)
CROSS = np.add.outer(np.arange(5) == 2, np.arange(5) == 2)


@pytest.mark.parametrize("sigma", [0.0, 0.05])
def test_known_gains_are_recovered(sigma):
    gain = cross_gains()
    field = changed(textured(low=0.2), gain=gain, noise=sigma)
    rough = np.asarray(rough_exposure(field).gain)
    assert np.abs(rough / gain - 1)[CROSS].max() < 0.02
    along = np.asarray(exposure_along(field, jnp.float32(1), FLAT).gain)
    assert np.abs(along / gain - 1)[CROSS].max() < (0.003 if sigma == 0 else 0.01)
    assert (along[~CROSS] == 1).all()


def test_gains_of_all_views_are_recovered_and_those_of_the_crosshair_do_not_change():
    gain = 1 + 0.05 * np.random.default_rng(3).standard_normal((5, 5)).astype(np.float32)
    gain[2, 2] = 1
    field = changed(textured(low=0.2), gain=gain)
    every, cross = (
        np.asarray(exposure_along(field, jnp.float32(1), FLAT, every=which).gain)
        for which in (True, False)
    )
    assert np.abs(every / gain - 1).max() < 0.003
    np.testing.assert_allclose(every[CROSS], cross[CROSS], atol=1e-3)


def test_equal_views_keep_their_brightness():
    field = changed(textured(low=0.2))
    assert np.abs(np.asarray(rough_exposure(field).gain) - 1).max() < 0.003
    along = exposure_along(field, jnp.float32(1), FLAT)
    assert np.abs(np.asarray(along.gain) - 1).max() < 0.0005


def test_taking_out_gains_and_exposure_gives_the_bright_views_back():
    gain = cross_gains()
    bright = textured(low=0.2)
    exposure = rough_exposure(bright)
    assert float(exposure.scale) == 1
    dark = changed(bright, gain=gain, factor=0.25, bits=False)
    scale = rough_exposure(dark).scale
    found = expose(dark, exposure_along(dark, scale, FLAT))
    level = np.quantile(np.asarray(bright.centre_view), 0.99)
    assert float(scale) == pytest.approx(0.56 / (0.25 * level), rel=0.02)
    # The level is a number of the part.
    half = Brightness(bright=jnp.asarray(0.28))
    assert float(rough_exposure(dark, params=half).scale) == pytest.approx(0.5 * float(scale))
    ratio = np.asarray(found.views)[CROSS] / np.asarray(bright.views)[CROSS]
    assert np.abs(ratio / ratio.mean() - 1).max() < 0.004


def test_a_missing_view_has_the_gain_one_and_changes_no_other():
    gain = cross_gains()
    field = changed(textured(low=0.2), gain=gain)
    there = jnp.ones((5, 5), bool).at[2, 0].set(False)
    found = []
    for value in (0.0, 0.9):
        # Under jit, where the crosshair may have gaps.
        views = field.views.at[2, 0].set(value)
        gains = jax.jit(
            lambda v: (
                rough_exposure(LightField(v, available=there)).gain,
                exposure_along(LightField(v, available=there), jnp.float32(1), FLAT).gain,
            )
        )(views)
        found.append(np.asarray(gains))
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0][:, 2, 0] == 1).all()
    # And the others keep theirs.
    np.testing.assert_allclose(found[0][:, 2, 4], gain[2, 4], rtol=0.02)


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_constant_views_are_left_finite(value):
    field = LightField(jnp.full((3, 5, 16, 9, 3), value, jnp.float32))
    for exposure in (
        rough_exposure(field),
        exposure_along(field, jnp.float32(1), jnp.zeros((16, 9), jnp.float32)),
    ):
        assert 1 <= float(exposure.scale) <= 16
        np.testing.assert_allclose(exposure.gain, 1, atol=1e-6)


def test_gradients_and_jit():
    gain = cross_gains()
    field = changed(textured(size=(32, 40), dtype=np.float64, low=0.2), gain=gain, bits=False)
    weight = jax.random.normal(jax.random.key(1), (5, 5), jnp.float64)
    disparity = 0.5 + 0.05 * jax.random.normal(jax.random.key(2), (32, 40), jnp.float64)

    def loss(tree):
        views, disparity = tree
        field = LightField(views)
        rough, along = rough_exposure(field), exposure_along(field, jnp.ones(()), disparity)
        return jnp.sum(weight * rough.gain) + rough.scale + jnp.sum(weight[::-1] * along.gain)

    check_gradient(loss, (field.views, disparity), rtol=1e-4, step=2e-9, key=jax.random.key(0))
    np.testing.assert_allclose(
        loss((field.views, disparity)), jax.jit(loss)((field.views, disparity)), rtol=1e-10
    )
