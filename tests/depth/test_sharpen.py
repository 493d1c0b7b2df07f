"""Sharpening by the weighted median, and the smoothness of color and depth steps."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes, count_traces
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from mvedge_jax.depth import Sharpen
from mvedge_jax.depth._median import _box_sum, weighted_median
from mvedge_jax.smoothness import ColorAndDepth, edge_smoothness

GUIDE = jnp.asarray(np.random.default_rng(0).uniform(size=(3, 24, 30)))


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


@pytest.mark.parametrize("radius", [1, 2, 4, 7])
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
    for mode in ("clip", "median", "quantised"):
        sharp = Sharpen(radius=6, mode=mode)(blurred, guide)
        assert np.abs(np.asarray(sharp) - step).mean() < 0.4 * before
    assert_array_equal(Sharpen(mode="none")(blurred, guide), blurred)
    wrong: Any = "bilateral"
    with pytest.raises((ValueError, TypeError), match="bilateral"):
        Sharpen(mode=wrong)


def test_clip_keeps_precision_where_there_is_nothing_to_sharpen():
    y, x = np.mgrid[0:24, 0:30]
    slope = jnp.asarray(0.003 * x + 0.001 * y)
    assert_allclose(Sharpen(radius=5)(slope, GUIDE), slope, atol=5e-3)
    gradient = jax.grad(lambda d: Sharpen(radius=3)(d, GUIDE).sum())(slope)
    assert bool(jnp.isfinite(gradient).all())
    assert float(gradient.mean()) > 0.5


@pytest.mark.parametrize("quantised", [False, True])
def test_median_of_a_constant_is_the_constant(quantised):
    image, guide = jnp.full((9, 7), 0.3), GUIDE[:, :9, :7]
    found = weighted_median(image, guide, jnp.array(1e-6), radius=2, levels=8, quantised=quantised)
    assert_allclose(found, 0.3, atol=1e-9)


def test_median_with_a_flat_guide_is_the_plain_median():
    values = np.where(np.random.default_rng(2).uniform(size=(30, 30)) < 0.2, 1.0, 0.0)
    guide = jnp.full((3, 30, 30), 0.5)
    found = weighted_median(jnp.asarray(values), guide, jnp.array(1e-4), radius=3, levels=16)
    # The guided filter averages twice, so its window is the triangle of two boxes.
    weight = ndimage.uniform_filter(ndimage.uniform_filter(values, 7), 7)[8:-8, 8:-8]
    same = (np.asarray(found)[8:-8, 8:-8] > 0.5) == (weight > 0.5)
    assert same[np.abs(weight - 0.5) > 0.1].all()


@pytest.mark.slow
def test_median_has_both_modes_and_a_second_derivative():
    rng = np.random.default_rng(4)
    guide = jnp.asarray(rng.uniform(size=(3, 14, 17)))
    values = jnp.asarray(ndimage.gaussian_filter(rng.normal(size=(14, 17)), 1.5))
    weight = jnp.asarray(rng.normal(size=values.shape))

    def total(tree):
        return jnp.sum(weight * weighted_median(*tree, radius=3, levels=9) ** 2)

    check_modes(total, (values, guide, jnp.asarray(1e-2)), rtol=1e-5, key=jax.random.key(6))


def test_one_trace_serves_every_parameter():
    blurred, guide, _ = blurred_step()
    run, traces = count_traces(lambda part: part(blurred, guide))
    wide, tight = (run(Sharpen(radius=3, levels=8, slack=jnp.asarray(s))) for s in (0.2, 0.01))
    assert traces() == 1
    assert float(jnp.abs(wide - tight).max()) > 0
