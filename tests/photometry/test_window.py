"""Windows against SciPy and plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes
from scipy import ndimage

from mvedge_jax.photometry._window import color_weights, contrast, weighted_sum


@pytest.mark.parametrize("spacing", [1, 2])
def test_mean_over_neighbours_of_like_colour(spacing):
    rng = np.random.default_rng(spacing)
    image, lab = rng.standard_normal((9, 11)), 5 * rng.standard_normal((3, 9, 11))
    weights = color_weights(jnp.asarray(lab), jnp.asarray(4.0), reach=1, spacing=spacing)
    found = weighted_sum(jnp.asarray(image)[None], weights, spacing=spacing)[0]
    for y, x in np.ndindex(9, 11):
        total = sums = 0.0
        for dy, dx in np.ndindex(3, 3):
            other = (
                np.clip(y + (dy - 1) * spacing, 0, 8),
                np.clip(x + (dx - 1) * spacing, 0, 10),
            )
            weight = np.exp(-np.linalg.norm(lab[:, *other] - lab[:, y, x]) / 4)
            total, sums = total + weight, sums + weight * image[other]
        assert float(found[y, x]) == pytest.approx(sums / total)


@pytest.mark.parametrize("radius", [0, 1, 3, 5])
def test_contrast_is_the_largest_gradient_nearby(radius):
    lab = np.random.default_rng(radius).standard_normal((3, 14, 17))
    taps = np.array([1, 4, 6, 4, 1]) / 16
    square = 0.0
    for channel in lab:
        for axis in (0, 1):
            channel = ndimage.correlate1d(channel, taps, axis=axis, mode="nearest")
        for axis in (0, 1):
            slope = ndimage.correlate1d(channel, [-0.5, 0, 0.5], axis=axis, mode="nearest")
            square = square + slope**2
    expected = ndimage.maximum_filter(np.sqrt(square), 2 * radius + 1, mode="nearest")
    np.testing.assert_allclose(contrast(jnp.asarray(lab), radius=radius), expected, atol=1e-12)


def test_gradients_match_differences_and_are_finite_where_all_is_equal():
    key = jax.random.key(0)

    def loss(lab):
        weights = color_weights(lab, jnp.asarray(4.0), reach=1)
        return jnp.sum(weighted_sum(lab, weights) ** 2) + jnp.sum(contrast(lab, radius=2))

    check_gradient(loss, 9 * jax.random.normal(key, (3, 6, 7)), rtol=1e-6, step=1e-6, key=key)
    assert bool(jnp.isfinite(jax.grad(loss)(jnp.ones((3, 6, 7)))).all())


@pytest.mark.parametrize("mode", ["edge", "constant"])
def test_derivatives_of_the_sum_in_images_and_weights_in_every_mode(mode):
    key = jax.random.split(jax.random.key(1))
    images, weights = jax.random.normal(key[0], (2, 7, 8)), jax.random.normal(key[1], (9, 7, 8))

    def loss(tree):
        return jnp.sum(jnp.sin(weighted_sum(*tree, spacing=2, mode=mode)))

    check_modes(loss, (images, weights), rtol=1e-6, key=key[0])


def test_reverse_mode_keeps_weights_and_not_what_they_are_made_from():
    lab = jax.ShapeDtypeStruct((3, 20, 24), jnp.float64)

    def pulled(lab):
        return jax.vjp(lambda lab: color_weights(lab, jnp.asarray(4.0), reach=2), lab)[1]

    arrays = jax.tree.leaves(jax.eval_shape(pulled, lab))
    assert sum(array.size for array in arrays) < 4 * 25 * 20 * 24
