"""Colour spaces against scikit-image, OpenCV and closed forms."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from skimage.color import rgb2lab

from mvedge_jax import color


def test_lab_equals_scikit_image():
    image = np.random.default_rng(0).random((17, 23, 3), dtype=np.float32)
    ours = color.srgb_to_lab(jnp.asarray(image))
    np.testing.assert_allclose(ours, rgb2lab(image), atol=0.01)
    assert ours.dtype == jnp.float32


def test_planes_are_converted_as_images_are():
    views = jnp.asarray(np.random.default_rng(1).random((2, 3, 5, 7)))
    expected = color.srgb_to_lab(jnp.transpose(views, (0, 2, 3, 1)))
    found = color.planes_to_lab(views)
    np.testing.assert_array_equal(jnp.transpose(found, (0, 2, 3, 1)), expected)


def test_lab_of_known_colours():
    red = color.srgb_to_lab(jnp.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(red, [53.24, 80.09, 67.20], atol=0.01)
    np.testing.assert_allclose(color.srgb_to_lab(jnp.zeros(3)), 0, atol=1e-12)
    np.testing.assert_allclose(color.srgb_to_lab(jnp.ones(3)), [100, 0, 0], atol=1e-9)


def test_gray_equals_opencv():
    image = np.random.default_rng(1).random((5, 7, 3), dtype=np.float32)
    ours = color.srgb_to_gray(jnp.asarray(image))
    np.testing.assert_allclose(ours, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), atol=1e-4)


def test_gradients():
    image = jax.random.uniform(jax.random.key(0), (4, 5, 3), minval=0.05)

    def energy(i):
        return (color.srgb_to_lab(i) ** 2).sum()

    check_gradient(energy, image, rtol=1e-6, key=jax.random.key(1))
    black = jax.grad(lambda i: color.srgb_to_lab(i).sum())(jnp.zeros(3))
    assert jnp.isfinite(black).all()


def test_wrong_channels_are_refused():
    with pytest.raises(ValueError, match=r"three colour channels.*\(4, 4\)"):
        color.srgb_to_lab(jnp.zeros((4, 4)))


def test_factors_solve_what_is_nearly_singular():
    rng = np.random.default_rng(5)
    line = rng.normal(size=(200, 1)) * np.array([[0.3, 0.25, 0.2]]) + 1e-3 * rng.normal(
        size=(200, 3)
    )
    covariance, floor = np.cov(line.T), 1e-6
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    vector = np.array([1.0, -0.5, 0.25])
    expected = np.linalg.solve(covariance + floor * np.eye(3), vector)
    for dtype, tolerance in ((jnp.float64, 1e-9), (jnp.float32, 0.02)):
        moments = [jnp.asarray(covariance[pair], dtype) for pair in pairs]
        factors = color.factored(moments, jnp.asarray(floor, dtype))
        found = color.solved(factors, [jnp.asarray(c, dtype) for c in vector])
        np.testing.assert_allclose(found, expected, rtol=tolerance)
