"""Every verb on views that tell nothing, and of the least sizes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax import EdgeDepth, LightField
from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.model import Renderer, optimize_edges, start_from_depth
from mvedge_jax.model.approaches import ByEvidence
from mvedge_jax.model.optimization import all_at_once
from mvedge_jax.posed import Photographs, StereoDepth, reference_of, stereo
from mvedge_jax.superpixels import SuperpixelClustering, soft_superpixels, superpixels

pytestmark = pytest.mark.slow  # half a minute of compilation each

COLORS = {"black": (0.0, 0.0, 0.0), "constant": (0.5, 0.4, 0.6), "saturated": (1.0, 1.0, 1.0)}
NAMES = (*COLORS, "two colors")
SMALL = [(1, 1), (1, 40), (40, 1)]


def _field(name, shape=(16, 16)):
    image = np.full((*shape, 3), COLORS.get(name, (0.2, 0.2, 0.2)))
    if name == "two colors":
        image[shape[0] // 2 :, shape[1] // 2 :] = (0.9, 0.6, 0.1)
    views = np.broadcast_to(image, (3, 3, *image.shape))
    return LightField(jnp.asarray(views, jnp.float32), disparity_range=(-1.0, 2.0))


def _center(field):
    choices = {"refine.sharpen.levels": 4, "refine.sharpen.radius": 2}
    return EdgeDepth.for_light_field(field, choices=choices)(field)


def _finite(tree):
    leaves = [leaf for leaf in jax.tree.leaves(tree) if eqx.is_inexact_array(leaf)]
    assert leaves
    for leaf in leaves:
        assert bool(jnp.isfinite(leaf).all())


@pytest.mark.parametrize(
    ("name", "shape"),
    [*((name, (16, 16)) for name in NAMES), *(("two colors", shape) for shape in SMALL)],
)
def test_views_superpixels_and_optimization(name, shape):
    field = _field(name, shape)
    result = _center(field)
    maps = depth_of_views(field, result, ViewDepth.for_light_field(field))
    _finite((maps.disparity, maps.error))
    assert bool((maps.error >= 0).all())

    model = SuperpixelClustering.for_depths(maps, choices={"size": 4.0})
    labels = superpixels(field, maps, model).labels
    assert labels.shape == field.views.shape[:4]
    assert bool((labels[field.center] > 0).all())
    assert len(np.unique(labels[field.center])) <= max(1, 2 * shape[0] * shape[1] // 4)

    routine = all_at_once(ByEvidence().rates, iterations=2)
    start = start_from_depth(field, result)
    found = optimize_edges(field, start, ByEvidence(), Renderer.on_raster(1), routine=routine)
    _finite(found.disparity)


@pytest.mark.parametrize("name", NAMES)
def test_gradients_of_every_view_and_of_soft_superpixels(name):
    field = _field(name)
    result, every = _center(field), ViewDepth.for_light_field(field)
    model = SuperpixelClustering(capacity=32, margin=2, rounds=2).replace(size=6.0)

    @jax.jit
    def gradient(views, measured, every, model):
        def total(views, measured, every, model):
            seen = eqx.tree_at(lambda f: f.views, field, views)
            known = eqx.tree_at(lambda r: r.disparity, result, measured)
            maps = depth_of_views(seen, known, every)
            soft = soft_superpixels(seen, maps, model)
            return maps.disparity.sum() + maps.error.sum() + (soft.shares**2).sum()

        return jax.grad(total, argnums=(0, 1, 2, 3))(views, measured, every, model)

    _finite(gradient(field.views, result.disparity, every, model))


def _photographs(name, shape):
    images = _field(name, shape).views[0]
    poses = np.broadcast_to(np.eye(4), (3, 4, 4)).copy()
    poses[:, 0, 3] = (0.0, 0.1, -0.1)
    matrix = np.array([[20.0, 0, shape[1] / 2], [0, 20.0, shape[0] / 2], [0, 0, 1]])
    return Photographs(images, poses, matrix), images


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        *((name, (16, 16)) for name in NAMES),
        # The smallest that photographs may be.
        *(("two colors", shape) for shape in ((8, 8), (8, 40), (40, 8))),
    ],
)
def test_photographs_and_their_gradients(name, shape):
    photographs, images = _photographs(name, shape)
    reference = reference_of(photographs, 0, depth_range=(1.0, 4.0))
    choices = {"refine.solves": 1, "refine.sharpen.levels": 4}
    model = StereoDepth.of(reference, choices=choices)
    found = stereo(photographs, reference, model)
    _finite((found.depth, found.disparity, found.disparity_error))
    assert bool((found.disparity_error > 0).all())

    def total(model, images):
        seen = eqx.tree_at(lambda p: p.images, photographs, images)
        return stereo(seen, reference, model).disparity.sum()

    _finite(jax.jit(jax.grad(total, argnums=(0, 1)))(model, images))


@pytest.mark.parametrize("shape", SMALL)
def test_photographs_of_a_single_row_are_refused(shape):
    with pytest.raises(ValueError, match=f"at least 8 px a side, got {shape[0]}x{shape[1]}"):
        _photographs("two colors", shape)
