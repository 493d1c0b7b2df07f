"""Backward warp: against SciPy, against a shifted ramp, gradients, and what is outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces
from scipy import ndimage

from mvedge_jax.warping import backward_warp


def _inputs(shape=(13, 17)):
    rng = np.random.default_rng(0)
    return jnp.asarray(rng.random((*shape, 3))), jnp.asarray(rng.normal(size=shape))


@pytest.mark.parametrize("step", [(2.0, -1.0), (0.0, 3.0), (-1.5, 0.0)])
def test_agrees_with_scipy(step):
    image, disparity = _inputs()
    warped, inside = backward_warp(image, disparity, jnp.asarray(step))
    y, x = np.mgrid[:13, :17].astype(float)
    x, y = x + step[0] * np.asarray(disparity), y + step[1] * np.asarray(disparity)
    for channel in range(3):
        expected = ndimage.map_coordinates(image[..., channel], [y, x], order=1, mode="nearest")
        np.testing.assert_allclose(warped[..., channel], expected, atol=1e-12)
    np.testing.assert_array_equal(inside, (x >= 0) & (x <= 16) & (y >= 0) & (y <= 12))
    assert 0 < inside.sum() < inside.size


def test_follows_the_convention():
    # A point at x of the centre view is at x + (u_c - u) d in view u.
    x = jnp.arange(20.0)
    centre = (x * 0.1)[None, :, None]
    right = ((x + 2 * 0.75) * 0.1)[None, :, None]  # view u = u_c + 2: content moved left by 1.5
    warped, inside = backward_warp(right, jnp.full((1, 20), 0.75), jnp.array([-2.0, 0.0]))
    np.testing.assert_allclose(warped[inside], centre[inside], atol=1e-12)
    assert inside.sum() == 18


def test_other_view_may_have_another_size():
    image, _ = _inputs((5, 9))
    warped, inside = backward_warp(image, jnp.zeros((7, 8)), jnp.array([1.0, 1.0]))
    assert warped.shape == (7, 8, 3)
    np.testing.assert_array_equal(warped[:5], image[:, :8])
    np.testing.assert_array_equal(inside, np.arange(7)[:, None] + np.zeros(8) < 5)


def test_gradients_match_differences():
    image, disparity = _inputs((6, 7))
    target = jnp.asarray(np.random.default_rng(1).random((6, 7, 3)))

    def loss(tree):
        warped, inside = backward_warp(*tree)
        return jnp.sum(jnp.where(inside[..., None], (warped - target) ** 2, 0))

    tree = (image, 0.3 * disparity, jnp.array([1.3, -0.7]))
    check_gradient(loss, tree, rtol=1e-6, step=1e-7, key=jax.random.key(2))


def test_disparity_that_is_not_finite_is_outside_and_harmless():
    image, disparity = _inputs()
    bad = disparity.at[3, 4].set(jnp.nan).at[5, 6].set(jnp.inf)
    warped, inside = backward_warp(image, bad, jnp.array([1.0, 0.0]))
    assert not inside[3, 4]
    assert not inside[5, 6]
    assert jnp.isfinite(warped).all()
    gradient = jax.grad(lambda d: backward_warp(image, d, jnp.array([1.0, 0.0]))[0].sum())(bad)
    assert jnp.isfinite(gradient).all()
    assert gradient[3, 4] == gradient[5, 6] == 0


def test_one_trace_vmap_over_views_and_single_precision():
    image, disparity = _inputs()
    steps = jnp.array([[1.0, 0.0], [0.0, -2.0], [2.5, 1.0]])
    counted, traces = count_traces(backward_warp)
    single = jnp.stack([counted(image, disparity, step)[0] for step in steps])
    assert traces() == 1
    mapped, _ = jax.vmap(backward_warp, (None, None, 0))(image, disparity, steps)
    np.testing.assert_allclose(mapped, single, atol=1e-12)
    narrow, _ = backward_warp(image.astype(jnp.float32), disparity.astype(jnp.float32), steps[0])
    assert narrow.dtype == jnp.float32
    np.testing.assert_allclose(narrow, single[0], atol=5e-6)
