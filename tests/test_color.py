"""Color spaces against scikit-image, OpenCV and closed forms."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, lean
from skimage.color import rgb2lab

from mvedge_jax import color


@pytest.mark.parametrize("planes", [False, True])
def test_lab_equals_scikit_image(planes):
    image = np.random.default_rng(0).random((17, 23, 3), dtype=np.float32)
    ours = color.srgb_to_lab(jnp.asarray(image))
    if planes:
        ours = jnp.moveaxis(color.planes_to_lab(jnp.moveaxis(image, -1, 0)[None])[0], 0, -1)
    np.testing.assert_allclose(ours, rgb2lab(image), atol=0.01)
    assert ours.dtype == jnp.float32


def test_gray_equals_opencv():
    image = np.random.default_rng(1).random((5, 7, 3), dtype=np.float32)
    ours = color.srgb_to_gray(jnp.asarray(image))
    np.testing.assert_allclose(ours, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), atol=1e-4)


def test_gradients():
    image = jax.random.uniform(jax.random.key(0), (4, 5, 3), minval=0.05)
    check_gradient(
        lambda i: (color.srgb_to_lab(i) ** 2).sum(), image, rtol=1e-6, key=jax.random.key(1)
    )
    black = jax.grad(lambda i: color.srgb_to_lab(i).sum())(jnp.zeros(3))
    assert jnp.isfinite(black).all()


def test_wrong_channels_are_refused():
    with pytest.raises(ValueError, match=r"three color channels.*\(4, 4\)"):
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


def test_the_slope_of_a_solution_is_that_of_the_inverse():
    """Both modes and the second derivative, against differences and the dense inverse."""
    moments = jnp.asarray([0.09, 0.074, 0.06, 0.0625, 0.049, 0.04])
    vector = jnp.asarray([1.0, -0.5, 0.25])

    def by_factors(tree):
        moments, floor, vector = tree
        return jnp.sum(
            jnp.stack(color.solved(color.factored(list(moments), floor), list(vector))) ** 2
        )

    def by_inverse(tree):
        (rr, rg, rb, gg, gb, bb), floor, vector = tree
        matrix = jnp.asarray([[rr, rg, rb], [rg, gg, gb], [rb, gb, bb]]) + floor * jnp.eye(3)
        return jnp.sum(jnp.linalg.solve(matrix, vector) ** 2)

    tree = (moments, jnp.asarray(1e-2), vector)
    for derivative in (jax.grad, jax.jacfwd, jax.hessian):
        found, expected = (lean(derivative(of))(tree) for of in (by_factors, by_inverse))
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8 * float(jnp.abs(b).max()))


def test_slopes_of_flat_colors_stay_in_single_precision():
    # No intermediate is more than the inverse squared.
    moments = [jnp.asarray(0.0, jnp.float32)] * 6
    floor = jnp.asarray(1e-6, jnp.float32)
    large = jnp.asarray(1e24, jnp.float32)

    def first(moments):
        return large * color.solved(color.factored(moments, floor), [floor] * 3)[0]

    slopes = jax.grad(first)(moments)
    np.testing.assert_allclose(slopes, np.float32(1e24) * np.array([-1e6, -1e6, -1e6, 0, 0, 0]))
