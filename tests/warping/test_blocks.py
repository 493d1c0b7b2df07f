"""Stencils that are wanted in parts of an image only."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.warping._blocks import _SIDE, in_blocks

_REACH = 2


def _box_and_product(pieces):
    """Sums over 5x5 pixels of the first image, and the product of both images."""
    height, width = (size - 2 * _REACH for size in pieces.shape[-2:])
    span = range(2 * _REACH + 1)
    box = sum(pieces[:, 0, y : y + height, x : x + width] for y in span for x in span)
    inner = pieces[:, :, _REACH : _REACH + height, _REACH : _REACH + width]
    return jnp.stack([box, inner[:, 0] * inner[:, 1]], axis=1)


def _whole(images):
    margin = ((0, 0), (_REACH, _REACH), (_REACH, _REACH))
    return _box_and_product(np.pad(images, margin)[None])[0]


@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (200, 130)])
@pytest.mark.parametrize("share", [0.0, 0.002, 0.1, 1.0])
def test_what_is_wanted_is_that_of_the_whole_image(shape, share):
    rng = np.random.default_rng(0)
    images, wanted = rng.normal(size=(2, *shape)), rng.random(shape) < share
    found = np.asarray(
        in_blocks(_box_and_product, jnp.asarray(wanted), jnp.asarray(images), reach=_REACH)
    )
    expected = np.asarray(_whole(images))
    assert found.shape == expected.shape
    np.testing.assert_allclose(found[:, wanted], expected[:, wanted], rtol=1e-12, atol=1e-12)
    # Whole blocks are computed, and no others.
    rows, columns = (-(-size // _SIDE) for size in shape)
    for row in range(rows):
        for column in range(columns):
            block = np.s_[row * _SIDE : (row + 1) * _SIDE, column * _SIDE : (column + 1) * _SIDE]
            all_of_it = expected[:, *block] if wanted[block].any() else 0 * expected[:, *block]
            np.testing.assert_allclose(found[:, *block], all_of_it, rtol=1e-12, atol=1e-12)


def test_batches_of_images_are_a_loop_over_them():
    rng = np.random.default_rng(1)
    images = jnp.asarray(rng.normal(size=(3, 2, 40, 40)))
    wanted = jnp.asarray(rng.random((3, 40, 40)) < jnp.asarray([0, 0.001, 0.1])[:, None, None])

    def one(wanted, images):
        return in_blocks(_box_and_product, wanted, images, reach=_REACH)

    loop = jnp.stack([one(w, i) for w, i in zip(wanted, images, strict=True)])
    np.testing.assert_allclose(jax.jit(jax.vmap(one))(wanted, images), loop, rtol=1e-12, atol=1e-12)
