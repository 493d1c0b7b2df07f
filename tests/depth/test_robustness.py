"""The chain on views that are noisy, dark, or of different brightness."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from photometry.scenes import changed, cross_gains

from experiments import robustness
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField


@pytest.fixture(scope="module")
def scene():
    return synthetic.render(
        synthetic.scene("edges"), shape=(5, 5, 48, 56), samples=2, key=jax.random.key(0)
    )


@pytest.fixture(scope="module")
def estimate(scene):
    # One range, one program.
    choices = {"refine.sharpen.levels": 16, "refine.sharpen.radius": 3}
    model = EdgeDepth.for_light_field(scene.without_truth(), choices=choices)

    def run(light_field):
        field = LightField(light_field.views, disparity_range=scene.disparity_range)
        return model(field)

    return run


@pytest.fixture(scope="module")
def clean(scene, estimate):
    return estimate(changed(scene))


def _error(result, scene):
    return np.abs(np.asarray(result.disparity) - np.asarray(scene.truth.disparity))


def test_gains_and_darkness_hardly_show(scene, estimate, clean):
    gain = cross_gains()
    result = estimate(changed(scene, gain=gain, factor=0.5))
    cross = np.add.outer(np.arange(5) == 2, np.arange(5) == 2)
    found = np.asarray(result.stats.exposure.gain)
    np.testing.assert_allclose(found[cross], gain[cross], rtol=0.01)
    assert float(result.stats.exposure.scale) > 1.2
    assert np.median(_error(result, scene)) < 0.02
    assert np.mean(_error(result, scene)) < 2 * np.mean(_error(clean, scene)) + 0.01


def test_noise_is_reported_and_nothing_overflows(scene, estimate, clean):
    assert float(clean.stats.noise.alpha) < 0.5
    result = estimate(changed(scene, noise=0.05))
    assert float(result.stats.noise.alpha) > 0.95
    assert abs(float(result.stats.noise.deviation) / 0.05 - 1) < 0.25
    assert int(result.stats.edges.overflow) == 0
    assert bool(jnp.isfinite(result.disparity).all())
    assert np.median(_error(result, scene)) < 0.25


def test_the_experiment_changes_the_crosshair_and_forgets_the_truth(scene):
    found = robustness.changed(scene, robustness.CHANGES["noise .02"])
    assert found.truth is None
    assert found.disparity_range is None
    assert int(found.available.sum()) == 9
    views, there = np.asarray(found.views), np.asarray(found.available)
    difference = (views - np.asarray(scene.views))[there]
    inner = (np.asarray(scene.views)[there] > 0.1) & (np.asarray(scene.views)[there] < 0.9)
    assert abs(difference[inner].std() / 0.02 - 1) < 0.05
    np.testing.assert_allclose(255 * views, np.round(255 * views), atol=1e-4)
    every = robustness.changed(scene, robustness.CHANGES["noise .02"], every=True)
    assert bool(every.available.all())
    np.testing.assert_array_equal(np.asarray(every.views)[there], views[there])
    rest = (np.asarray(every.views) - np.asarray(scene.views))[~there]
    assert abs(rest.std() / 0.02 - 1) < 0.05
    clean = robustness.changed(scene, robustness.CHANGES["clean"])
    np.testing.assert_array_equal(
        np.asarray(clean.views)[there], np.asarray(scene.views, np.float32)[there]
    )
