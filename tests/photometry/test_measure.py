"""The dense measurement: right, honest about its errors, blind to what is missing."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import check_gradient
from photometry.planes import plane_arms

from mvedge_jax.photometry import PhotometricParams, photometric_labels


def with_values(parameters, **values):
    """Parameters with some numbers set."""
    return parameters(**{name: jnp.asarray(value) for name, value in values.items()})


def test_a_photometric_step_finds_the_plane_and_knows_how_well():
    truth, start = 0.31, 0.28
    errors, predicted = [], []
    for seed in range(3):
        arms = plane_arms(truth, noise=0.01, seed=seed)
        labels = photometric_labels(
            arms[0],
            arms[1],
            jnp.full((20, 28), start),
            with_values(PhotometricParams, noise=0.01),
            radius=2,
            passes=2,
        )
        inner = (slice(4, -4), slice(4, -4))
        errors.append((np.asarray(labels.disparity) - truth)[inner])
        predicted.append(np.sqrt(np.asarray(labels.variance))[inner])
    error = np.sqrt(np.mean(np.square(errors)))
    assert error < 0.25 * (truth - start)
    assert 0.5 < error / np.sqrt(np.mean(np.square(predicted))) < 2


def test_missing_views_take_no_part():
    across, down = plane_arms(0.2)
    there = across.available.at[0].set(False)
    params = PhotometricParams()
    disparity = jnp.full((20, 28), 0.15)

    def measure(planes):
        arm = across._replace(planes=planes, available=there)
        return photometric_labels(arm, down, disparity, params, radius=2, passes=1).disparity

    junk = across.planes.at[0].set(0.123)
    np.testing.assert_array_equal(measure(across.planes), measure(junk))
    gradient = jax.grad(lambda p: measure(p).sum())(across.planes)
    assert float(jnp.abs(gradient[0]).max()) == 0
    assert float(jnp.abs(gradient[1]).max()) > 0


def test_flat_images_leave_the_map_alone_and_say_so():
    arms = plane_arms(0.0)
    flat = tuple(a._replace(planes=jnp.full_like(a.planes, 0.5)) for a in arms)
    labels = photometric_labels(
        flat[0], flat[1], jnp.full((20, 28), 0.4), PhotometricParams(), radius=2, passes=2
    )
    np.testing.assert_allclose(labels.disparity, 0.4, atol=1e-9)
    assert float(labels.variance.min()) > 1


def test_gradient_of_the_measurement_matches_differences():
    across, down = plane_arms(0.2, views=(3, 3), size=(8, 9))
    disparity = 0.15 + 0.01 * jnp.sin(jnp.arange(72.0).reshape(8, 9))

    def loss(tree):
        planes, disparity, params = tree
        found = photometric_labels(
            across._replace(planes=planes), down, disparity, params, radius=2, passes=1
        )
        return jnp.sum(found.disparity**2) + jnp.sum(1 / (1 + 1e4 * found.variance))

    tree = (across.planes, disparity, PhotometricParams())
    check_gradient(loss, tree, rtol=1e-5, step=1e-6, key=jax.random.key(1))
