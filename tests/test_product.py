"""Every product of the programs keeps all bits of its factors, on accelerators, too."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.epi._response import correlate
from mvedge_jax.lightfield import LightField
from mvedge_jax.losses.features import FilterBank
from mvedge_jax.losses.terms import ssim
from mvedge_jax.posed import projections
from mvedge_jax.posed.cloud import surface_of
from mvedge_jax.splatting import SplatRaster, SplatWidths, splat
from mvedge_jax.superpixels import SuperpixelClustering, superpixels

_PRODUCTS = ("stablehlo.dot_general", "stablehlo.convolution")
_IMAGE = np.random.default_rng(0).random((24, 28, 3), dtype=np.float32)


def _products(function, *arguments):
    """Lines of the lowered program that are products of floats."""
    text = jax.jit(function).lower(*arguments).as_text()
    lines = [line for line in text.splitlines() if any(name in line for name in _PRODUCTS)]
    return [line for line in lines if re.search(r"-> tensor<[^>]*f(32|64)>", line)]


_VIEWS = np.broadcast_to(_IMAGE, (3, 3, *_IMAGE.shape))


def _chain(views):
    """All that becomes of the views: center view, every view, superpixels."""
    with jax.ensure_compile_time_eval():
        blank = LightField(jnp.asarray(_VIEWS), disparity_range=(-1.0, 1.0))
        chain, model = EdgeDepth.for_light_field(blank), ViewDepth.for_light_field(blank)
    field = eqx.tree_at(lambda f: f.views, blank, views)
    result = chain(field)
    depths = depth_of_views(field, result, model)
    found = superpixels(field, depths, SuperpixelClustering(capacity=64, margin=2))
    return depths.disparity, found.plane


def _splat(xy):
    ones = jnp.ones(len(xy), xy.dtype)
    return splat(xy, ones, ones, ones > 0, SplatWidths(), (24, 28), SplatRaster()).label


def _posed(pose):
    matrix = jnp.broadcast_to(jnp.diag(jnp.asarray([20.0, 20.0, 1.0], pose.dtype)), (2, 3, 3))
    poses = jnp.stack([pose, pose.at[0, 3].set(0.1)])
    found = projections(poses, matrix, 0, jnp.asarray(2.0, pose.dtype))
    wall = surface_of(jnp.full((9, 9), 3.0, pose.dtype), pose, matrix[0])
    return found, wall.points, wall.normals


def _gradient(function):
    return jax.value_and_grad(lambda x: sum(jnp.sum(leaf) for leaf in jax.tree.leaves(function(x))))


def _bank(rows):
    return correlate(rows, jnp.swapaxes(rows, 1, 2)[:, :, :5])


_PLANES = np.moveaxis(_IMAGE, -1, 0)
_PROGRAMS = {
    "chain": (_chain, _VIEWS),
    "bank": (_gradient(_bank), _IMAGE),
    "points": (_gradient(_splat), np.ones((40, 2), np.float32)),
    "photographs": (_gradient(_posed), np.eye(4, dtype=np.float32)),
    "colors": (_gradient(lambda x: (srgb_to_lab(x), srgb_to_gray(x))), _IMAGE),
    "features": (_gradient(FilterBank()), _PLANES),
    "similarity": (_gradient(lambda x: ssim(x, x * x)), _PLANES),
}


@pytest.mark.parametrize("name", _PROGRAMS)
def test_products_keep_all_bits(name):
    function, argument = _PROGRAMS[name]
    products = _products(function, jnp.asarray(argument))
    assert products, "a program without products tests nothing"
    for line in products:
        assert line.count("HIGHEST") == 2, line
