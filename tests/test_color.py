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
