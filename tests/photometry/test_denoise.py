"""Guide, low-pass and pooling: strong under noise, absent without it, differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, dot, lean
from photometry.scenes import changed, textured
from scipy import interpolate, ndimage

from mvedge_jax._crosshair import crosshair
from mvedge_jax.image import box_mean, gaussian, highest
from mvedge_jax.photometry import Noise
from mvedge_jax.photometry.brightness._denoise import denoised, passed, soften
from mvedge_jax.photometry.matching._pooling import Pooling, pooled

NONE = Noise.of(jnp.zeros(()))
STRONG = Noise.of(jnp.asarray(0.05))


def test_filters_agree_with_scipy():
    image = np.random.default_rng(0).normal(size=(2, 13, 9))
    np.testing.assert_allclose(
        box_mean(jnp.asarray(image), 2),
        np.stack([ndimage.uniform_filter(i, 5, mode="nearest") for i in image]),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        gaussian(jnp.asarray(image), jnp.asarray(0.8), 3),
        ndimage.gaussian_filter(image, (0, 0.8, 0.8), mode="nearest", radius=(0, 3, 3)),
        atol=1e-12,
    )
    for radius in (1, 2, 5, 6):
        np.testing.assert_array_equal(
            highest(jnp.asarray(image[0]), radius),
            ndimage.maximum_filter(image[0], 2 * radius + 1, mode="nearest"),
        )


def test_without_noise_nothing_changes():
    field = textured(size=(20, 24), dtype=np.float64)
    image = jnp.moveaxis(field.center_view, -1, 0)
    np.testing.assert_array_equal(denoised(image, NONE), image)
    planes = crosshair(field).horizontal.planes
    np.testing.assert_array_equal(soften(planes, NONE, jnp.asarray(1.0)), planes)
    kept, grain = passed(NONE, jnp.asarray(1.0))
    assert float(kept) == float(grain) == 1
    cost = jax.random.uniform(jax.random.key(0), (4, 20, 24), jnp.float64)
    np.testing.assert_array_equal(pooled(cost, image, NONE, Pooling()), cost)


@pytest.mark.parametrize("sigma", [0.3, 0.6, 1.0])
def test_a_low_pass_keeps_the_share_of_noise_that_it_says(sigma):
    white = jax.random.normal(jax.random.key(0), (5, 3, 64, 64), jnp.float64)
    soft = soften(white, STRONG, jnp.asarray(sigma))
    kept, grain = passed(STRONG, jnp.asarray(sigma))
    assert float(soft[..., 4:-4, 4:-4].var()) == pytest.approx(float(kept), rel=0.03)

    def roughness(planes):
        """Energy of the derivative of the splines along x over that of the splines."""
        rows = np.asarray(planes).reshape(-1, 64)
        spline = interpolate.make_interp_spline(np.arange(64), rows, k=3, axis=1)
        x = np.arange(8, 56, 0.125)
        return (spline.derivative()(x) ** 2).mean() / (spline(x) ** 2).mean()

    found = roughness(soft) / roughness(white)
    assert found == pytest.approx(float(grain), rel=0.03)


def test_pooling_stays_on_a_surface_and_away_from_outlines():
    # The left half costs 1, the right half 3; a strip of 4 px beside the outline lies.
    cost = np.where(np.arange(80) < 40, 1.0, 3.0) * np.ones((1, 60, 1))
    cost[..., 40:44] = 1.0
    cost += np.random.default_rng(2).normal(0, 0.5, cost.shape)
    lab = jnp.asarray(np.where(np.arange(80) < 40, 20.0, 70.0) * np.ones((3, 60, 1)))
    found = np.asarray(pooled(jnp.asarray(cost), lab, STRONG, Pooling()))[0]
    assert np.abs(found[:, 5:35] - 1).max() < 0.3
    assert np.abs(found[:, 44:75] - 3).max() < 0.3
    constant = pooled(jnp.full((2, 60, 80), 0.7), lab, STRONG, Pooling())
    np.testing.assert_allclose(constant, 0.7, rtol=1e-9)


def test_gradients_in_both_modes_jit_and_vmap():
    field = changed(textured(size=(14, 17), dtype=np.float64), noise=0.03, bits=False)
    image, planes = (jnp.moveaxis(field.center_view, -1, 0), crosshair(field).horizontal.planes)
    keys = jax.random.split(jax.random.key(0))
    cost, weights = (jax.random.uniform(key, (3, 14, 17), jnp.float64) - 0.5 for key in keys)

    def loss(tree):
        image, cost, deviation, length = tree
        noise = Noise.of(deviation)
        guide = denoised(image, noise)
        soft = soften(planes, noise, 10 * deviation)
        kept, grain = passed(noise, 10 * deviation)
        total = jnp.sum(weights * pooled(cost, 100 * guide, noise, Pooling(length=length)))
        return total + jnp.sum(guide[0] * weights[0]) + kept * grain * jnp.sum(soft[1] ** 3)

    tree = (image, cost, jnp.asarray(0.03), jnp.asarray(6.0))
    check_gradient(loss, tree, rtol=1e-4, step=1e-7, key=jax.random.key(2))

    def of(deviation):
        return loss((image, cost, deviation, tree[3]))

    deviations = jnp.asarray([0.0, 0.03])
    together = lean(jax.vmap(of))(deviations)
    np.testing.assert_allclose(together, [of(s) for s in deviations], rtol=1e-9)
    forward = lean(lambda t: (jax.jvp(loss, (t,), (t,))[1], jax.grad(loss)(t)))
    tangent, gradient = forward(tree)
    np.testing.assert_allclose(tangent, dot(gradient, tree), rtol=1e-8)
