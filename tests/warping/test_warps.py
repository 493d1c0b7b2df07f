"""Backward warp: against SciPy, against a shifted ramp, gradients, and what is outside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes, count_traces
from scipy import ndimage

from mvedge_jax import warping
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
    # A point at x of the center view is at x + (u_c - u) d in view u.
    x = jnp.arange(20.0)
    center = (x * 0.1)[None, :, None]
    right = ((x + 2 * 0.75) * 0.1)[None, :, None]  # view u = u_c + 2: content moved left by 1.5
    warped, inside = backward_warp(right, jnp.full((1, 20), 0.75), jnp.array([-2.0, 0.0]))
    np.testing.assert_allclose(warped[inside], center[inside], atol=1e-12)
    assert inside.sum() == 18


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


forward_warp, warp_planes = jax.jit(warping.forward_warp), jax.jit(warping.warp_planes)
visible, visible_binned = jax.jit(warping.visible), jax.jit(warping.visible_binned)


def brute_force(image, disparity, step):
    """Loops over pixels from far to near, so that the nearest is written last."""
    height, width = disparity.shape
    out, depth = np.zeros_like(image), np.zeros_like(disparity)
    hit, owner = np.zeros(disparity.shape, bool), np.full(disparity.shape, -1)
    order = np.lexsort((-np.arange(disparity.size), disparity.ravel()))
    for i in order:
        y, x = divmod(i, width)
        d = disparity[y, x]
        tx, ty = np.floor(x + step[0] * d + 0.5), np.floor(y + step[1] * d + 0.5)
        if 0 <= tx < width and 0 <= ty < height:
            tx, ty = int(tx), int(ty)
            out[ty, tx], depth[ty, tx], hit[ty, tx], owner[ty, tx] = (image[y, x], d, True, i)
    return out, depth, hit, owner


def scene(shape=(13, 17), seed=0):
    rng = np.random.default_rng(seed)
    disparity = np.where(rng.random(shape) > 0.7, 1.5, 0.2) + rng.normal(size=shape) * 1e-2
    return rng.random((*shape, 3)), disparity


@pytest.mark.parametrize("step", [(2.0, 0.0), (-3.0, 1.0), (0.0, 0.0)])
def test_forward_warp_equals_painting_far_to_near(step):
    image, disparity = scene()
    result = forward_warp(jnp.array(image), jnp.array(disparity), jnp.array(step))
    out, depth, hit, _ = brute_force(image, disparity, step)
    np.testing.assert_array_equal(result.hit, hit)
    np.testing.assert_array_equal(result.image, out)
    np.testing.assert_array_equal(result.disparity, depth)


def test_exact_visibility_equals_the_winners_of_painting():
    image, disparity = scene()
    step = (3.0, -1.0)
    owner = brute_force(image, disparity, step)[3]
    seen = visible(jnp.array(disparity), jnp.array(step), tolerance=0.0)
    np.testing.assert_array_equal(np.flatnonzero(seen), np.unique(owner[owner >= 0]))


@pytest.mark.parametrize("mask", [visible, visible_binned])
def test_a_near_square_hides_the_strip_beside_it(mask):
    disparity = jnp.zeros((16, 16)).at[4:12, 6:10].set(2.0)
    seen = mask(disparity, jnp.array([2.0, 0.0]))
    expected = np.ones((16, 16), bool)
    expected[4:12, 10:14] = False  # the square lands here
    np.testing.assert_array_equal(seen, expected)


@pytest.mark.parametrize("mask", [visible, visible_binned])
def test_masks_of_odd_input(mask):
    flat = jnp.full((5, 4), 0.3)
    assert bool(mask(flat, jnp.zeros(2)).all())
    assert not bool(mask(flat, jnp.array([100.0, 0.0])).any())
    seen = mask(flat.at[2, 2].set(jnp.nan), jnp.zeros(2))
    assert int(jnp.sum(~seen)) == 1
    gradient = jax.grad(lambda d: jnp.sum(jnp.where(mask(d, jnp.array([1.0, 0.0])), d, 0)))(flat)
    np.testing.assert_array_equal(gradient, mask(flat, jnp.array([1.0, 0.0])))


def test_a_pixel_that_is_no_number_does_not_widen_the_bins():
    # Columns 10 and 11 land on one pixel, the first in front; 4.0 is the farthest of the map.
    disparity = jnp.full((2, 80), 4.8).at[:, 10].set(4.9).at[:, -1].set(4.0)
    step = jnp.array([10.0, 0.0])
    expected = visible_binned(disparity, step)
    assert bool(expected[1, 10])
    assert not bool(expected[1, 11])
    seen = visible_binned(disparity.at[0, 0].set(jnp.nan), step)
    np.testing.assert_array_equal(seen[1], expected[1])
    assert not bool(visible_binned(jnp.full((3, 3), jnp.nan), jnp.zeros(2)).any())


@pytest.mark.parametrize("step", [(3.0, 0.0), (-2.0, 1.5)])
def test_warp_of_planes_equals_the_backward_warp(step):
    image, disparity = scene()
    image, disparity, step = jnp.array(image), jnp.array(disparity), jnp.array(step)
    expected, _ = backward_warp(image, disparity, step)
    planes = jnp.moveaxis(image, -1, 0)
    np.testing.assert_allclose(
        warp_planes(planes, disparity, step), jnp.moveaxis(expected, -1, 0), atol=1e-14
    )


@pytest.mark.parametrize("moving", ["planes", "disparity"])
def test_warp_of_planes_in_both_modes(moving):
    image, disparity = scene()
    tree = {"planes": jnp.moveaxis(jnp.array(image), -1, 0), "disparity": jnp.array(disparity)}
    some = {moving: tree[moving]}

    def loss(some):
        full = {**tree, **some}
        return jnp.sum(warp_planes(full["planes"], full["disparity"], jnp.array([-2.0, 1.5])) ** 3)

    check_modes(loss, some, rtol=1e-5, step=1e-7, key=jax.random.key(1))
