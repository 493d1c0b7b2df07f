"""Plane sweep: planes with known disparity, occlusion, and the rules of every stage."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces, shared_data
from scipy import ndimage

from mvedge_jax.datasets import load_light_field
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.reconstruct import SweepParams, SweepSizes, plane_sweep

_SMALL = SweepSizes(planes=9, radius=1)


def _params(**values):
    return SweepParams(**{name: jnp.asarray(value) for name, value in values.items()})


def _plane(disparity, *, shape=(5, 5, 21, 26), seed=0):
    """Views of one smooth random plane, sampled from a spline at the exact places."""
    rng = np.random.default_rng(seed)
    rows, columns, height, width = shape
    pad = 8
    texture = ndimage.gaussian_filter(rng.random((height + 2 * pad, width + 2 * pad, 3)), (1, 1, 0))
    texture = (texture - texture.min()) / np.ptp(texture)
    y, x = np.mgrid[:height, :width] + float(pad)
    views = np.zeros((*shape, 3))
    for v, u in np.ndindex(rows, columns):
        at = [y - (rows // 2 - v) * disparity, x - (columns // 2 - u) * disparity]
        for c in range(3):
            views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], at, order=3)
    return LightField(np.clip(views, 0, 1), disparity_range=(-1.5, 1.5))


@pytest.mark.parametrize("disparity", [-1.03, 0.0, 0.4])
def test_finds_a_plane_to_a_fraction_of_a_step(disparity):
    result = plane_sweep(_plane(disparity), sizes=SweepSizes(planes=31, radius=2))
    error = jnp.abs(result.disparity - disparity)
    # The planes are 0.1 apart: a fifth of a step in the middle, half a step at worst.
    assert jnp.median(error) < 0.02
    assert error[3:-3, 3:-3].max() < 0.05
    assert result.cost.max() < 0.5


def test_beside_an_occluder_the_better_half_sees_the_background():
    # A foreground bar at d = 2 before a background at d = 0, integer shifts.
    rng = np.random.default_rng(1)
    far, near = rng.random((2, 24, 40, 3))
    views = np.zeros((5, 5, 24, 40, 3))
    x = np.arange(40)
    for v, u in np.ndindex(5, 5):
        left = 15 + (2 - u) * 2
        bar = (x >= left) & (x < left + 8)
        shifted = np.roll(near, ((2 - v) * 2, (2 - u) * 2), (0, 1))
        views[v, u] = np.where(bar[:, None], shifted, far)
    scene = LightField(views, disparity_range=(-1.0, 3.0))
    truth = np.where((x >= 15) & (x < 23), 2.0, 0.0)[None]
    beside = np.s_[5:-5, 12:15]
    wrong = {}
    for margin in (0.05, 2.0):
        params = _params(margin=margin, sigma=0.7)
        found = plane_sweep(scene, params=params, sizes=_SMALL).disparity
        wrong[margin] = np.abs(np.asarray(found) - truth)[beside] > 0.2
    assert wrong[0.05].mean() < 0.05
    assert wrong[0.05].sum() <= wrong[2.0].sum()


def test_agrees_with_a_plain_search():
    # Integer planes, no window, no halves: the cost is a mean over shifted views.
    scene = _plane(1.0, shape=(3, 3, 9, 11))
    params = _params(margin=2.0, sigma=0.0, scale=0.1)
    result = plane_sweep(
        scene, params=params, sizes=SweepSizes(planes=5, radius=0), disparity_range=(-2.0, 2.0)
    )
    views = np.asarray(scene.views)
    costs = []
    for d in (-2, -1, 0, 1, 2):
        arms = []
        for arm in ([(1, 0), (1, 2)], [(0, 1), (2, 1)]):
            total, count = np.zeros((2, 9, 11))
            for v, u in arm:
                for y, x in np.ndindex(9, 11):
                    b, a = y + (1 - v) * d, x + (1 - u) * d
                    if 0 <= b < 9 and 0 <= a < 11:
                        error = ((views[v, u, b, a] - views[1, 1, y, x]) ** 2).mean()
                        total[y, x] += error / (error + 0.1**2)
                        count[y, x] += 1
            arms.append(np.where(count > 0, total / np.maximum(count, 1), 1))
        costs.append(sum(arms) / 2)
    np.testing.assert_array_equal(result.plane, np.argmin(costs, 0))
    np.testing.assert_allclose(result.cost, np.min(costs, 0), atol=1e-12)


def test_a_missing_view_is_not_read():
    scene = _plane(0.4)
    available = np.ones((5, 5), bool)
    available[0, 0] = False
    spoilt = eqx.tree_at(lambda s: s.views, scene, scene.views.at[0, 0].set(0.9))
    spoilt = eqx.tree_at(lambda s: s.available, spoilt, jnp.asarray(available))
    np.testing.assert_array_equal(
        plane_sweep(spoilt, sizes=_SMALL).disparity, plane_sweep(scene, sizes=_SMALL).disparity
    )


def test_one_trace_for_all_values():
    scene = _plane(0.4, shape=(3, 3, 9, 12))
    counted, traces = count_traces(
        lambda s, p, r: plane_sweep(s, params=p, sizes=_SMALL, disparity_range=r).disparity
    )
    for scale, high in ((0.01, 1.0), (0.1, 1.5)):
        counted(scene, _params(scale=scale), jnp.array([-1.0, high]))
    assert traces() == 1


@pytest.mark.slow
def test_gradients_match_differences():
    scene = _plane(0.4, shape=(3, 3, 9, 12))

    def loss(tree):
        params, views = tree
        moved = eqx.tree_at(lambda s: s.views, scene, views)
        return jnp.sum(plane_sweep(moved, params=params, sizes=_SMALL).disparity ** 2)

    # No margin: choosing a half is a kink that differences may step over.
    check_gradient(
        loss,
        (_params(margin=2.0, scale=0.1), scene.views),
        rtol=1e-4,
        step=1e-7,
        key=jax.random.key(0),
    )


def test_single_precision_is_close():
    scene = _plane(0.4)
    double = plane_sweep(scene, sizes=_SMALL).disparity
    lower = eqx.tree_at(lambda s: s.views, scene, scene.views.astype(jnp.float32))
    single = plane_sweep(lower, sizes=_SMALL).disparity
    assert single.dtype == jnp.float32
    assert np.median(np.abs(np.asarray(single) - np.asarray(double))) < 1e-4


def test_bad_input_says_what_is_wrong():
    scene = _plane(0.0, shape=(3, 3, 9, 11))
    scene = eqx.tree_at(lambda s: s.disparity_range, scene, None)
    with pytest.raises(ValueError, match="`disparity_range` must be given"):
        inspect.unwrap(plane_sweep)(scene)
    with pytest.raises(ValueError, match="`planes` must"):
        SweepSizes(planes=1)
    with pytest.raises(ValueError, match="`radius` must"):
        SweepSizes(radius=-1)


@pytest.mark.slow
def test_cotton():
    """What issue 4 compares with: a baseline without regularisation, but not a straw man."""
    scene = load_light_field(shared_data("hci", "cotton"))
    result = plane_sweep(scene)
    assert scene.truth is not None
    scores = depth_scores(result.disparity, scene.truth.disparity)
    assert scores.mse < 3.2
    assert scores.bad_07 < 5.5
