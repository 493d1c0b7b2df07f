"""The volume of costs and its transpose, part by part, and the plane sweep."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces, lean, with_values
from photometry.scenes import plane_views

from mvedge_jax.photometry.matching import Matching, _volume, plane_sweep
from mvedge_jax.photometry.matching._arm import Half, Limits, Swept
from mvedge_jax.photometry.matching._volume import Sweep, volume

_RNG = np.random.default_rng(0)


def _uniform(*shape):
    return _RNG.uniform(size=shape)


def _arm(height, width, *, window, counts):
    def half(sign, count):
        padding = ((0, 0), (0, 0), (0, 0), (width, width + 3))
        planes = np.pad(_uniform(count, 3, height, width), padding, mode="edge")
        steps = sign * jnp.asarray([1.5, 4.0])[:count]
        return Half(jnp.asarray(planes), steps, jnp.ones(count))

    def weights():
        found = _uniform((2 * window + 1) ** 2, height, width)
        return jnp.asarray(found / found.sum(0))

    share = jnp.asarray(_uniform(height, width))
    halves = half(-1, counts[0]), half(1, counts[1])
    return Swept(jnp.asarray(_uniform(3, height, width)), halves, weights(), weights(), share)


def _sweep(shape, *, window, counts, alpha):
    limits = Limits(jnp.asarray(0.05), jnp.asarray(0.02), jnp.asarray(alpha))
    across = _arm(*shape, window=window, counts=counts)
    down = _arm(*shape[::-1], window=window, counts=counts)
    return Sweep(across, down, jnp.linspace(-2, 2.1, 5), limits)


def _cotangent(shape, share):
    """Of few pixels, of no pixel of one hypothesis, and of the corners."""
    found = _RNG.normal(size=(5, *shape)) * (_RNG.uniform(size=(5, *shape)) < share)
    found[1] = 0
    found[3, 0, 0], found[2, -1, -1] = 1, 2
    return jnp.asarray(found)


def _alike(found, expected):
    for (path, a), b in zip(
        jax.tree_util.tree_leaves_with_path(found), jax.tree.leaves(expected), strict=True
    ):
        close = 1e-11 * (1 + np.abs(b).max(initial=0))
        np.testing.assert_allclose(a, b, atol=close, err_msg=jax.tree_util.keystr(path))


# Sides that are no multiple of a part's, or less than one; a half without views, in a batch.
@pytest.mark.parametrize(
    ("shape", "share", "window", "counts", "alpha", "batch"),
    [((12, 37), 0.01, 1, (1, 1), 0.3, False), ((20, 24), 1.0, 0, (1, 0), 0.0, True)],
)
def test_the_transpose_is_that_of_the_costs(
    shape, share, window, counts, alpha, batch, monkeypatch
):
    monkeypatch.setattr(_volume, "_PART", 16)
    sweep = _sweep(shape, window=window, counts=counts, alpha=alpha)
    value, own = jax.vjp(lambda s: volume(window, s), sweep)
    plain, expected = jax.vjp(_volume._costs, sweep)
    np.testing.assert_array_equal(value, plain)
    cotangent = _cotangent(shape, share)
    if batch:
        cotangent = jnp.stack([cotangent, jnp.zeros((5, *shape))])
        own, expected = jax.vmap(own), jax.vmap(expected)
    _alike(lean(own)(cotangent), lean(expected)(cotangent))


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


def test_one_trace_for_all_values_and_single_precision_is_close():
    scene = _plane(0.4, views=(3, 3), size=(9, 12))
    counted, traces = count_traces(
        lambda s, p, r: plane_sweep(s, params=p, **_SMALL, disparity_range=r).disparity
    )
    _, double = (
        counted(scene, with_values(Matching, truncation=truncation), jnp.array([-1.0, high]))
        for truncation, high in ((8.0, 1.0), (4.0, 1.5))
    )
    assert traces() == 1
    lower = eqx.tree_at(lambda s: s.views, scene, scene.views.astype(jnp.float32))
    params = with_values(Matching, truncation=4.0)
    single = plane_sweep(lower, params=params, **_SMALL, disparity_range=(-1.0, 1.5))
    assert single.disparity.dtype == jnp.float32
    assert np.median(np.abs(np.asarray(single.disparity) - np.asarray(double))) < 1e-4


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
