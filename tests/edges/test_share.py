"""Labels shared between the pixels around them, against a loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes

from mvedge_jax.edges import share

_TOLERANCE = 0.2


@pytest.fixture
def labels():
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1.5, 8.5, (40, 2))
    disparity, weight = rng.normal(size=40), rng.uniform(0.1, 1, 40)
    weight[::7] = 0
    surface = 0.3 * rng.normal(size=(6, 8))
    return jnp.asarray(xy), jnp.asarray(disparity), jnp.asarray(weight), jnp.asarray(surface)


def test_shares_are_those_of_a_loop(labels):
    xy, disparity, weight, surface = map(np.asarray, labels)
    total, moved = np.zeros((6, 8)), np.zeros((6, 8))
    for (x, y), d, w in zip(xy, disparity, weight, strict=True):
        for row, column in np.ndindex(6, 8):
            bilinear = max(0, 1 - abs(x - column)) * max(0, 1 - abs(y - row))
            part = w * bilinear / (1 + ((d - surface[row, column]) / _TOLERANCE) ** 2) ** 2
            total[row, column] += part
            moved[row, column] += part * d
    found, mean = share(*labels, tolerance=jnp.asarray(_TOLERANCE))
    np.testing.assert_allclose(found, total, atol=1e-12)
    hit = total > 1e-9
    np.testing.assert_allclose(np.asarray(mean)[hit], moved[hit] / total[hit], atol=1e-9)
    empty = total == 0
    assert empty.any()
    np.testing.assert_array_equal(np.asarray(mean)[empty], surface[empty])


def test_empty_slots_change_nothing_and_have_no_gradient(labels):
    xy, disparity, weight, surface = labels

    def loss(xy, disparity):
        total, mean = share(xy, disparity, weight, surface, jnp.asarray(_TOLERANCE))
        return jnp.sum(total * jnp.sin(mean))

    empty = weight == 0
    other = jnp.where(empty[:, None], 3.3, xy), jnp.where(empty, 0.1, disparity)
    assert float(loss(xy, disparity)) == float(loss(*other))
    gradient = jax.grad(loss, argnums=(0, 1))(*other)
    assert not np.asarray(gradient[0])[np.asarray(empty)].any()
    assert not np.asarray(gradient[1])[np.asarray(empty)].any()


def test_derivatives_in_positions_labels_weights_map_and_tolerance(labels):
    xy, disparity, weight, surface = labels
    weight = weight + 0.1

    def loss(tree):
        total, mean = share(*tree)
        return jnp.sum(total * jnp.sin(mean))

    tree = (xy, disparity, weight, surface, jnp.asarray(_TOLERANCE))
    check_modes(loss, tree, rtol=1e-5, key=jax.random.key(0))
