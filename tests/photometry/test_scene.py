"""The prepared scene, its first measurement, and what views show of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane, two_planes

from mvedge_jax._params import cast
from mvedge_jax.photometry import (
    first_labels,
    hypothesis_count,
    occluder_radius,
    prepare,
    prepare_views,
)
from mvedge_jax.photometry.brightness import GridViews
from mvedge_jax.photometry.matching import Matching, best_match
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    Measurement,
    PhotometricLabels,
    ViewSplines,
)
from mvedge_jax.photometry.measuring._measure import average_over_surface
from mvedge_jax.photometry.views import views_of


def _prepared(light_field, low, high, *, radius=3):
    tried = jnp.linspace(low, high, hypothesis_count(high - low, max(light_field.centre)))
    tried = tried.astype(light_field.views.dtype)
    scene = prepare(GridViews(light_field), tried, cast(Matching(), tried.dtype), window=2)
    return scene, prepare_views(scene, cast(Measurement(radius=radius), tried.dtype)), tried


def test_the_first_measurement_finds_a_plane():
    scene, seen, _ = _prepared(plane(0.37, views=9, size=(24, 32)), 0.0, 0.7)
    assert scene.first is not None
    found, _ = first_labels(scene, seen)
    off = np.abs(np.asarray(found.disparity) - 0.37)
    rough = np.abs(np.asarray(scene.first) - 0.37)
    assert np.median(off) < 0.002
    assert np.median(off) < 0.3 * np.median(rough)


def test_a_scene_without_a_first_map_or_arms_is_told():
    scene, seen, _ = _prepared(plane(0.37), 0.0, 0.7)
    with pytest.raises(ValueError, match="`scene` has no first map; `prepare` finds one"):
        first_labels(scene._replace(hypotheses=None), seen)
    views = views_of(plane(0.37))
    with pytest.raises(ValueError, match="`prepared` must be views of a crosshair, got photogr"):
        first_labels(scene, seen._replace(splines=ViewSplines.of(views)))
    with pytest.raises(TypeError, match="`views` must be a crosshair to have arms, got photogr"):
        _ = scene._replace(views=views).arms


def test_neighbours_share_labels_on_their_surface_only():
    key = jax.random.split(jax.random.key(0))
    truth = jnp.where(jnp.arange(24) < 12, 0.8, -0.6)[None] * jnp.ones((20, 1))
    noisy = truth + 0.01 * jax.random.normal(key[0], truth.shape)
    variance = jnp.full_like(truth, 1e-4).at[:, 3].set(1e4)
    noisy = noisy.at[:, 3].add(0.02 * jax.random.normal(key[1], (20,)))
    lab = jnp.zeros((3, 20, 24))
    labels = PhotometricLabels(noisy, variance, variance)
    found = average_over_surface(labels, lab, AdaptedMeasurement(), passes=2)
    before, after = (np.abs(np.asarray(d - truth)) for d in (noisy, found.disparity))
    assert after.mean() < 0.5 * before.mean()
    # An uncertain label follows the others, and none crosses the step.
    assert after[:, 3].mean() < 0.3 * before[:, 3].mean()
    assert after.max() < 0.03
    np.testing.assert_array_equal(found.variance, variance)


def test_views_that_a_nearer_surface_hides_or_that_differ_weigh_little():
    light_field = two_planes(0.8, -0.6, edge=30.2)
    _, seen, _ = _prepared(light_field, -0.9, 1.1, radius=12)
    truth = jnp.where(jnp.arange(64) < 30, 0.8, -0.6)[None] * jnp.ones((16, 1))
    truth = truth.astype(jnp.float32)
    assert isinstance(seen.splines, CrosshairSplines)
    _, weights = seen.splines.accumulate_with_weights(truth, seen.params)
    assert weights.shape == (18, 16, 64)
    # Right of the border, the near plane comes over the pixel in views of one side only.
    across = np.asarray(weights[9:, 4:12, 33]).mean(1)
    hidden, shown = (across[:2], across[6:]) if across[0] < across[-1] else (across[7:], across[:3])
    assert hidden.max() == 0
    assert shown.min() > 0.3
    painted = light_field.views.at[4, 0].set(0.9)
    spoilt = type(light_field)(painted, disparity_range=(-0.9, 1.1))
    _, seen, _ = _prepared(spoilt, -0.9, 1.1, radius=12)
    assert isinstance(seen.splines, CrosshairSplines)
    weights = np.asarray(seen.splines.accumulate_with_weights(truth, seen.params)[1])
    inner = weights[9:, 4:12, 10:24].mean((1, 2))
    assert inner[0] < 0.3
    assert inner[1:].min() > 0.5


def test_the_best_match_is_the_least_of_its_costs():
    scene, _, tried = _prepared(plane(0.5, views=5), 0.0, 1.0)
    params = cast(Matching(), tried.dtype)
    disparity, cost = best_match(scene.arms, scene.lab, tried, params, window=2)
    assert float(jnp.median(jnp.abs(disparity - 0.5))) < 0.02
    for shift in (-1, 1):
        other = tried + shift * 0.37
        worse = best_match(scene.arms, scene.lab, other[-2:], params, window=2)[1]
        assert float(jnp.mean(cost <= worse + 1e-6)) > 0.99
    assert 0 <= float(cost.min()) <= float(cost.max()) <= 2


def test_sizes_follow_range_and_views():
    assert hypothesis_count(2.0, 4) == 17
    assert hypothesis_count(0.0, 4) == 2
    assert occluder_radius(2.0, 4, (100, 50)) == 8
    assert occluder_radius(200.0, 4, (100, 50)) == 100
    assert occluder_radius(0.0, 4, (100, 50)) == 1
