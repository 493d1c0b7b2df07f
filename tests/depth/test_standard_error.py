"""Standard errors of a map: closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from mvedge_jax.depth._standard_error import StandardError, sharpest


def _stated(of_labels, disparity):
    return np.asarray(StandardError()(jnp.asarray(of_labels), jnp.asarray(disparity)))


@pytest.mark.parametrize("label", [0.006, 0.02, 0.5])
def test_on_planes_only_the_labels_count(label):
    rows, columns = np.mgrid[:8, :9]
    found = _stated(np.full((8, 9), label), 0.3 * columns - 0.2 * rows + 1.0)
    np.testing.assert_allclose(found, 2.5 * label**2 / (label + 0.045), rtol=1e-6)


def test_a_step_and_a_bend_are_doubted_and_the_rest_is_not():
    columns = np.arange(12.0)
    step = np.broadcast_to(np.where(columns < 6, 0.0, 2.0), (5, 12))
    found = _stated(np.full((5, 12), 1e-4), step)[2]
    assert np.all(found[5:7] > 0.5 * 2.0)
    assert np.all(found[[0, 2, 4, 7, 9, 11]] < 1e-6)
    bowl = np.broadcast_to(0.001 * columns**2, (5, 12))
    found = _stated(np.full((5, 12), 1e-4), bowl)[2, 1:-1]
    np.testing.assert_allclose(found, np.hypot(4.5 * 0.002 / 1.02, 0.5 * 0.002), rtol=1e-4)


def test_without_labels_nothing_is_known():
    of_labels = np.where(np.arange(4) < 2, 0.0, 0.01)[None].repeat(3, 0)
    found = _stated(of_labels, np.zeros((3, 4)))
    assert np.isinf(found[:, :2]).all()
    assert np.isfinite(found[:, 2:]).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (1, 5), (3, 3)])
def test_small_maps_have_no_bends_at_their_borders(shape):
    found = sharpest(jnp.arange(float(np.prod(shape))).reshape(shape) ** 2)
    assert found.shape == shape
    assert bool((found == 0).all()) == (min(shape) < 3 and max(shape) < 3)


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
    np.testing.assert_array_equal(StandardError()(labels, flat, flat + 0.12**2), alone)
    wide = StandardError()(labels, flat, flat + 0.625**2)
    np.testing.assert_allclose(wide, np.hypot(alone, 0.5), rtol=1e-12)

    def total(around):
        found = StandardError()(labels.at[0].set(0.0), flat, around)
        return jnp.sum(jnp.where(jnp.isfinite(found), found, 0))

    slope = jax.grad(total)(flat + jnp.asarray([[0.0, 0.01, 0.3, 1.0]]))
    assert bool(jnp.isfinite(slope).all())
    assert bool((slope[0] == 0).all())
    assert bool((slope[1:, 2:] > 0).all())
