"""The prepared scene, its first measurement, and what views show of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane, two_planes

from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import (
    first_labels,
    hypothesis_count,
    occluder_radius,
    prepare,
    prepare_views,
)
from mvedge_jax.photometry.brightness import GridViews
from mvedge_jax.photometry.matching import Matching
from mvedge_jax.photometry.measuring import (
    AdaptedMeasurement,
    CrosshairSplines,
    Measurement,
    PhotometricLabels,
    ViewSplines,
)
from mvedge_jax.photometry.measuring._measure import average_over_surface
from mvedge_jax.photometry.views import views_of


def test_a_scene_without_a_first_map_or_arms_is_told():
    views = views_of(plane(0.37))

    def refused(light_field):
        tried = jnp.linspace(0, 0.7, 5).astype(light_field.views.dtype)
        scene = prepare(GridViews(light_field), tried, cast(Matching(), tried.dtype), window=2)
        seen = prepare_views(scene, cast(Measurement(radius=3), tried.dtype))
        with pytest.raises(ValueError, match="`scene` has no first map; `prepare` finds one"):
            first_labels(scene._replace(hypotheses=None), seen)
        with pytest.raises(ValueError, match="`prepared` must be views of a crosshair, got photo"):
            first_labels(scene, seen._replace(splines=ViewSplines.of(views)))
        with pytest.raises(TypeError, match="`views` must be a crosshair to have arms, got photo"):
            _ = scene._replace(views=views).arms
        return seen.params

    jax.eval_shape(refused, plane(0.37))  # before anything is compiled


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
    light_field, params = (
        two_planes(0.8, -0.6, edge=30.2),
        cast(AdaptedMeasurement(radius=12), jnp.float32),
    )
    truth = jnp.where(jnp.arange(64) < 30, 0.8, -0.6)[None] * jnp.ones((16, 1))

    def weights(views):
        splines = CrosshairSplines.of(crosshair(LightField(views)))
        return np.asarray(splines.accumulate_with_weights(truth.astype(jnp.float32), params)[1])

    found = weights(light_field.views)
    assert found.shape == (18, 16, 64)
    # Right of the border, the near plane comes over the pixel in views of one side only.
    across = found[9:, 4:12, 33].mean(1)
    hidden, shown = (across[:2], across[6:]) if across[0] < across[-1] else (across[7:], across[:3])
    assert hidden.max() == 0
    assert shown.min() > 0.3
    painted = weights(light_field.views.at[4, 0].set(0.9))[9:, 4:12, 10:24].mean((1, 2))
    assert painted[0] < 0.3
    assert painted[1:].min() > 0.5


def test_sizes_follow_range_and_views():
    assert hypothesis_count(2.0, 4) == 17
    assert hypothesis_count(0.0, 4) == 2
    assert occluder_radius(2.0, 4, (100, 50)) == 8
    assert occluder_radius(200.0, 4, (100, 50)) == 100
    assert occluder_radius(0.0, 4, (100, 50)) == 1
