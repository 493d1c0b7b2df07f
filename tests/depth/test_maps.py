"""What is done to maps: smoothness, sharpening, slopes, standard errors."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes
from jax.test_util import check_grads
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from mvedge_jax.depth import Sharpen
from mvedge_jax.depth._median import _box_sum, weighted_median
from mvedge_jax.depth._slopes import Slopes, rises, slope_labels
from mvedge_jax.depth._standard_error import StandardError, sharpest
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.smoothness import ColorAndDepth, edge_smoothness


def test_smoothness_needs_both_steps_to_cut():
    lab = jnp.zeros((3, 1, 5)).at[0, 0, 2:].set(40.0)
    depth = jnp.array([[0.0, 0.0, 1.0, 1.0, 1.0]])
    both, color, step = (
        edge_smoothness(*planes, ColorAndDepth())[0]
        for planes in ((lab, depth), (lab, 0 * depth), (0 * lab, depth))
    )
    assert float(both[0, 1]) < 1e-4
    assert float(color.min()) > 0.99
    assert float(step.min()) > 0.99
    # The formula, written out.
    expected = 1 / (1 + (40 / 0.3) ** 1.5 * (1 / 0.05) ** 2)
    assert float(both[0, 1]) == pytest.approx(max(expected, 1e-6), rel=1e-3)


def test_smoothness_gradient_matches_differences_and_is_finite_when_flat():
    keys = jax.random.split(jax.random.key(0))
    lab, depth = 10 * jax.random.normal(keys[0], (3, 5, 6)), jax.random.normal(keys[1], (5, 6))

    def loss(tree):
        lab, depth, logs = tree
        tx, ty = edge_smoothness(lab, depth, jax.tree.map(jnp.exp, logs))
        return jnp.sum(jnp.sqrt(tx)) + jnp.sum(jnp.sqrt(ty))

    logs = jax.tree.map(jnp.log, ColorAndDepth())
    check_gradient(loss, (lab, 0.1 * depth, logs), rtol=1e-5, step=1e-6, key=keys[0])
    flat = jax.grad(loss)((0 * lab, 0 * depth, logs))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(flat))


@pytest.mark.parametrize("radius", [1, 7])
def test_box_sums_agree_with_scipy(radius):
    image = np.random.default_rng(radius).uniform(size=(11, 17))
    width = 2 * radius + 1
    expected = ndimage.uniform_filter(image, width, mode="constant") * width**2
    assert_allclose(_box_sum(jnp.asarray(image), radius), expected, atol=1e-12)


def blurred_step():
    x = np.arange(40)
    step = np.where(x < 20, -0.5, 0.7)
    guide = np.where(x < 20, 0.2, 0.8)[None, None] * np.ones((3, 24, 1))
    ramp = np.interp(x, [17, 22], [-0.5, 0.7])
    return jnp.asarray(np.tile(ramp, (24, 1))), jnp.asarray(guide), step


def test_sharpening_moves_a_blurred_step_onto_the_color_step():
    blurred, guide, step = blurred_step()
    before = np.abs(np.asarray(blurred) - step).mean()
    for mode in ("clip", "median", "quantized"):
        sharp = Sharpen(radius=6, mode=mode)(blurred, guide)
        assert np.abs(np.asarray(sharp) - step).mean() < 0.4 * before
    assert_array_equal(Sharpen(mode="none")(blurred, guide), blurred)
    wrong: Any = "bilateral"
    with pytest.raises((ValueError, TypeError), match="bilateral"):
        Sharpen(mode=wrong)


def test_median_with_a_flat_guide_is_the_plain_median():
    values = np.where(np.random.default_rng(2).uniform(size=(30, 30)) < 0.2, 1.0, 0.0)
    guide = jnp.full((3, 30, 30), 0.5)
    found = weighted_median(jnp.asarray(values), guide, jnp.array(1e-4), radius=3, levels=16)
    # The guided filter averages twice, so its window is the triangle of two boxes.
    weight = ndimage.uniform_filter(ndimage.uniform_filter(values, 7), 7)[8:-8, 8:-8]
    same = (np.asarray(found)[8:-8, 8:-8] > 0.5) == (weight > 0.5)
    assert same[np.abs(weight - 0.5) > 0.1].all()


def test_a_part_has_the_median_of_the_whole_between_the_ends_of_the_whole():
    rng = np.random.default_rng(5)
    values, guide = (jnp.asarray(rng.uniform(size=(*c, 12, 40))) for c in ((), (3,)))
    sharpen, part = Sharpen(radius=3, levels=9, mode="median"), (..., slice(0, 30))
    values = values.at[0, -1].set(3.0)
    whole = sharpen(values, guide)
    alone, known = (
        sharpen(values[part], guide[part], ends=ends)
        for ends in (None, (jnp.min(values), jnp.max(values)))
    )
    assert_allclose(known[:, :24], whole[:, :24], atol=1e-12)
    assert float(jnp.abs(alone - whole[part])[:, :24].max()) > 0.01


def test_median_has_both_modes_and_a_second_derivative():
    rng = np.random.default_rng(4)
    guide = jnp.asarray(rng.uniform(size=(3, 14, 17)))
    values = jnp.asarray(ndimage.gaussian_filter(rng.normal(size=(14, 17)), 1.5))
    weight = jnp.asarray(rng.normal(size=values.shape))

    def total(tree):
        return jnp.sum(weight * weighted_median(*tree, radius=3, levels=9) ** 2)

    check_modes(total, (values, guide, jnp.asarray(1e-2)), rtol=1e-5, key=jax.random.key(6))


def asked(disparity, weight, edges, *, params=None, tolerance=1e-3):
    """The rises that follow from a map, as the chain solves for them."""
    params = Slopes() if params is None else params
    along = [params.stiffness * t for t in edges]
    solver = AutoSolver(tolerance=jnp.asarray(tolerance))
    found = [
        diffuse(System(held, label, *along), solver=solver).value
        for held, label in zip(*slope_labels(disparity, weight, edges, params), strict=True)
    ]
    return rises(jnp.stack(found))


def slanted_wall():
    """A plane known at both ends alone, and the smoothness of an image without outlines."""
    y, x = np.mgrid[0:24, 0:40]
    plane = jnp.asarray(0.02 * x - 0.01 * y)
    weight = jnp.full(plane.shape, 1e-4).at[:, :8].set(1.0).at[:, -8:].set(1.0)
    return plane, weight, (jnp.ones((24, 39)), jnp.ones((23, 40)))


def test_slopes_of_a_plane_are_its_own_and_a_cut_edge_is_none():
    plane, weight, edges = slanted_wall()
    along_x, along_y = asked(plane, weight, edges)
    assert_allclose(along_x, 0.02, rtol=0.01)
    assert_allclose(along_y, -0.01, rtol=0.01)
    step = jnp.tile(jnp.where(jnp.arange(40) < 15, 0.0, 0.2), (24, 1))
    cut = edges[0].at[:, 14].set(1e-6), edges[1]
    assert all(float(jnp.abs(rise).max()) < 1e-4 for rise in asked(step, jnp.ones((24, 40)), cut))


def test_gradient_matches_differences():
    keys = jax.random.split(jax.random.key(0), 4)
    disparity = 0.1 * jax.random.normal(keys[0], (7, 8))
    weight = jax.random.uniform(keys[1], (7, 8)) + 0.1
    tx, ty = (
        jax.random.uniform(k, s) + 0.1 for k, s in zip(keys[2:], ((7, 7), (6, 8)), strict=True)
    )

    def loss(tree):
        disparity, weight, tx, ty, params = tree
        along_x, along_y = asked(disparity, weight, (tx, ty), params=params, tolerance=1e-12)
        return jnp.sum(along_x**2) + jnp.sum((along_y - 0.1) ** 2)

    tree = disparity, weight, tx, ty, Slopes()
    check_gradient(loss, tree, rtol=1e-5, step=1e-6, key=keys[0])


def _stated(of_labels, disparity):
    return np.asarray(StandardError()(jnp.asarray(of_labels), jnp.asarray(disparity)))


@pytest.mark.parametrize("label", [0.006, 0.02, 0.5])
def test_on_planes_only_the_labels_count(label):
    rows, columns = np.mgrid[:8, :9]
    found = _stated(np.full((8, 9), label), 0.3 * columns - 0.2 * rows + 1.0)
    assert_allclose(found, 2.5 * label**2 / (label + 0.045), rtol=1e-6)


@pytest.mark.parametrize("shape", [(1, 2), (1, 5), (3, 3)])
def test_small_maps_have_no_bends_at_their_borders_and_are_unknown_without_labels(shape):
    found = sharpest(jnp.arange(float(np.prod(shape))).reshape(shape) ** 2)
    assert found.shape == shape
    assert bool((found == 0).all()) == (min(shape) < 3 and max(shape) < 3)
    assert np.isinf(_stated(np.zeros(shape), np.zeros(shape))).all()


def test_a_step_and_a_bend_are_doubted_and_the_rest_is_not():
    columns = np.arange(12.0)
    step = np.broadcast_to(np.where(columns < 6, 0.0, 2.0), (5, 12))
    found = _stated(np.full((5, 12), 1e-4), step)[2]
    assert np.all(found[5:7] > 0.5 * 2.0)
    assert np.all(found[[0, 2, 4, 7, 9, 11]] < 1e-6)
    bowl = np.broadcast_to(0.001 * columns**2, (5, 12))
    found = _stated(np.full((5, 12), 1e-4), bowl)[2, 1:-1]
    assert_allclose(found, np.hypot(4.5 * 0.002 / 1.02, 0.5 * 0.002), rtol=1e-4)


def test_derivatives_are_those_of_differences():
    of_labels = 0.01 + 0.02 * jax.random.uniform(jax.random.key(0), (4, 5), jnp.float64)
    disparity = jax.random.uniform(jax.random.key(1), (4, 5), jnp.float64)

    def total(*given):
        params, of_labels, disparity = jax.tree.map(jnp.asarray, given)
        return jnp.sum(jnp.log(params(of_labels, disparity)))

    check_grads(
        total, (StandardError(), of_labels, disparity), order=1, modes=["rev", "fwd"], eps=1e-6
    )


def test_rivals_add_what_the_labels_do_not_contain():
    flat, labels = jnp.zeros((3, 4)), jnp.full((3, 4), 0.2)
    alone = StandardError()(labels, flat)
    assert_array_equal(StandardError()(labels, flat, flat + 0.12**2), alone)
    wide = StandardError()(labels, flat, flat + 0.625**2)
    assert_allclose(wide, np.hypot(alone, 0.5), rtol=1e-12)

    def total(around):
        found = StandardError()(labels.at[0].set(0.0), flat, around)
        return jnp.sum(jnp.where(jnp.isfinite(found), found, 0))

    slope = jax.grad(total)(flat + jnp.asarray([[0.0, 0.01, 0.3, 1.0]]))
    assert bool(jnp.isfinite(slope).all())
    assert bool((slope[0] == 0).all())
    assert bool((slope[1:, 2:] > 0).all())
