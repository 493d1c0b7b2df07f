"""Plane sweep: planes with known disparity, occlusion, and the rules of every stage."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces, shared_data, with_values
from photometry.planes import plane_views

from mvedge_jax.datasets import load_light_field
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry.matching import Matching, plane_sweep

_SMALL: dict[str, Any] = {"planes": 9, "window": 1}


def _plane(disparity, *, views=(5, 5), size=(21, 26)):
    return plane_views(disparity, views=views, size=size, span=(-1.5, 1.5))


@pytest.mark.parametrize("disparity", [-1.03, 0.0, 0.4])
def test_finds_a_plane_to_a_fraction_of_a_step(disparity):
    result = plane_sweep(_plane(disparity), planes=31)
    error = jnp.abs(result.disparity - disparity)
    # The planes are 0.1 apart: a fifth of a step in the middle, half a step at worst.
    assert jnp.median(error) < 0.02
    assert error[3:-3, 3:-3].max() < 0.05
    # Of 2, where no view agrees.
    assert result.cost[3:-3, 3:-3].max() < 1


def test_agrees_with_a_plain_search():
    """Integer planes, single pixels: the oracle compares shifted views one by one."""
    scene = _plane(1.0, views=(3, 3), size=(9, 11))
    params = with_values(Matching, drift=0.0)
    result = plane_sweep(scene, params=params, planes=5, window=0, disparity_range=(-2.0, 2.0))
    views, costs = np.asarray(scene.views), []
    truncation = 4 * 3 * (1 / 255) ** 2
    for d in (-2, -1, 0, 1, 2):
        total = np.zeros((9, 11))
        for arm in ([(1, 0), (1, 2)], [(0, 1), (2, 1)]):
            halves = []
            for v, u in arm:
                y, x = np.mgrid[:9, :11]
                y, x = np.clip(y + (1 - v) * d, 0, 8), np.clip(x + (1 - u) * d, 0, 10)
                error = ((views[v, u, y, x] - views[1, 1]) ** 2).sum(-1)
                halves.append(error / (error + truncation))
            total += np.minimum(*halves)
        costs.append(total)
    planes = np.argmin(costs, 0)
    inner = (planes > 0) & (planes < 4)
    assert np.abs(np.asarray(result.disparity) - (planes - 2.0)).max() <= 0.5
    np.testing.assert_allclose(result.disparity[~inner], (planes - 2.0)[~inner])
    np.testing.assert_allclose(result.cost, np.min(costs, 0), atol=1e-12)


def test_single_precision_is_close():
    scene = _plane(0.4)
    lower = eqx.tree_at(lambda s: s.views, scene, scene.views.astype(jnp.float32))
    single, double = (plane_sweep(of, **_SMALL).disparity for of in (lower, scene))
    assert single.dtype == jnp.float32
    assert np.median(np.abs(np.asarray(single) - np.asarray(double))) < 1e-4


def test_one_trace_for_all_values():
    scene = _plane(0.4, views=(3, 3), size=(9, 12))
    counted, traces = count_traces(
        lambda s, p, r: plane_sweep(s, params=p, **_SMALL, disparity_range=r).disparity
    )
    for truncation, high in ((4.0, 1.0), (8.0, 1.5)):
        counted(scene, with_values(Matching, truncation=truncation), jnp.array([-1.0, high]))
    assert traces() == 1


@pytest.mark.slow
def test_gradients_match_differences():
    scene = _plane(0.4, views=(3, 3), size=(9, 12))

    def loss(tree):
        params, views = tree
        moved = eqx.tree_at(lambda s: s.views, scene, views)
        return jnp.sum(plane_sweep(moved, params=params, **_SMALL).disparity ** 2)

    tree = (Matching(), scene.views)
    check_gradient(loss, tree, rtol=1e-4, step=1e-7, key=jax.random.key(0))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({}, "`disparity_range` must be given"),
        ({"planes": 1, "disparity_range": (-1.0, 1.0)}, "`planes` must"),
        ({"window": -1, "disparity_range": (-1.0, 1.0)}, "`window` must"),
    ],
)
def test_bad_input_says_what_is_wrong(options, match):
    with pytest.raises(ValueError, match=match):
        inspect.unwrap(plane_sweep)(plane_views(0.0, views=(3, 3), size=(9, 11)), **options)


@pytest.mark.slow
def test_cotton():
    """A baseline without regularisation, but not a straw man."""
    scene = load_light_field(shared_data("hci", "cotton"))
    assert scene.truth is not None
    scores = depth_scores(plane_sweep(scene).disparity, scene.truth.disparity)
    assert scores.mse < 3.2
    assert scores.bad_07 < 5.5
