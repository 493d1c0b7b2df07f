"""Window sums and their transposes, slopes, points on pixels."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax.image import convolution, nearest_pixels, unit_gradient, window_sum


def test_points_are_on_their_nearest_pixels():
    at = nearest_pixels(jnp.array([[1.2, 2.4], [5.6, -0.2], [-0.7, 1.0]]), (4, 6))
    np.testing.assert_array_equal(at.inside, [True, False, False])
    np.testing.assert_array_equal(at.places(6), [13, 5, 6])


def test_unit_gradient_of_a_ramp_is_its_direction():
    y, x = jnp.mgrid[0:9, 0:12].astype(float)
    found = np.asarray(unit_gradient(0.3 * x - 0.4 * y))[3:-3, 3:-3]
    np.testing.assert_allclose(found, np.broadcast_to([0.6, -0.8], found.shape), atol=1e-12)
    np.testing.assert_array_equal(unit_gradient(jnp.full((5, 5), 0.3)), 0)


@pytest.mark.parametrize("radius", [0, 1, 3, 4, 7])
@pytest.mark.parametrize(("border", "mode"), [("edge", "nearest"), ("constant", "constant")])
def test_window_sums_agree_with_scipy(radius, border, mode):
    image = np.random.default_rng(radius).uniform(size=(9, 12))
    for axis in (0, 1):
        expected = ndimage.convolve1d(image, np.ones(2 * radius + 1), axis=axis, mode=mode)
        found = window_sum(jnp.asarray(image), radius, axis, border=border)
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(("radius", "axis"), [(0, 0), (1, -1), (4, 0)])
@pytest.mark.parametrize("border", ["edge", "constant"])
def test_transposed_window_sums_are_those_of_the_matrix(radius, border, axis):
    image = jax.random.normal(jax.random.key(radius), (7, 9))
    sums = partial(window_sum, radius=radius, axis=axis, border=border)
    matrix = jax.jacfwd(sums)(image).reshape(63, 63)
    transpose = jax.linear_transpose(sums, image)
    np.testing.assert_allclose(transpose(image)[0].ravel(), matrix.T @ image.ravel(), atol=1e-12)
    many = jax.vmap(lambda ct: transpose(ct)[0])(jnp.stack([image, -image, image**2]))
    np.testing.assert_allclose(many[2], transpose(image**2)[0], atol=1e-12)
    # Twice transposed, it is itself.
    again = jax.linear_transpose(lambda ct: transpose(ct)[0], image)
    np.testing.assert_allclose(again(image)[0], sums(image), atol=1e-12)


@pytest.mark.parametrize(
    "options",
    [
        {"padding": 1},
        {"stride": 2, "padding": ((0, 1), (2, 1))},
        {"dilation": 2, "padding": "SAME", "use_bias": False},
        {"groups": 2, "padding": 1, "padding_mode": "REFLECT"},
    ],
    ids=["plain", "strides", "dilation", "groups"],
)
def test_a_convolution_is_that_of_the_layer_with_its_derivatives(options):
    layer = eqx.nn.Conv2d(4, 6, 3, dtype=jnp.float64, **options, key=jax.random.key(0))
    planes = jnp.asarray(np.random.default_rng(0).normal(size=(4, 11, 14)))
    arrays, static = eqx.partition(layer, eqx.is_array)

    def ours(arrays, planes):
        return jnp.sum(convolution(eqx.combine(arrays, static), planes) ** 3)

    def plain(arrays, planes):
        return jnp.sum(eqx.combine(arrays, static)(planes) ** 3)

    for transform in (
        lambda f: f,
        lambda f: jax.grad(f, (0, 1)),
        lambda f: lambda *at: jax.jvp(f, at, at),
        lambda f: lambda *at: jax.jvp(jax.grad(f, (0, 1)), at, at),
        lambda f: lambda *at: jax.vmap(jax.grad(f), (None, 0))(at[0], jnp.stack([at[1]] * 2)),
    ):
        found, expected = (jax.jit(transform(f))(arrays, planes) for f in (ours, plain))
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9), found, expected)
