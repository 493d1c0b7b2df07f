"""Soft superpixels: shares by the formula, and gradients in views, depth and parameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient

from mvedge_jax.all_views import ViewDepths
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField
from mvedge_jax.superpixels import SuperpixelClustering, soft_superpixels, through_superpixels


def _scene(shape=(14, 17)):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: shape[0], : shape[1]]
    depth = np.where(x > 8, 0.4, 0.0) + 0.01 * y + 0.02 * rng.normal(size=shape)
    picture = np.clip(0.4 + 0.2 * (x > 8)[..., None] + 0.05 * rng.normal(size=(*shape, 3)), 0, 1)
    field = LightField(jnp.asarray(picture[None, None]))
    maps = jnp.asarray(depth[None, None])
    return field, ViewDepths(maps, 0 * maps, jnp.zeros(maps.shape, jnp.int8), jnp.asarray(0))


def _model(**numbers):
    few = SuperpixelClustering(capacity=16, margin=2, rounds=3)
    return few.replace({"size": 6.0, "temperature": 0.5, **numbers})


def _soft(field, depths, **numbers):
    return soft_superpixels(field, depths, _model(**numbers))


def test_shares_are_those_of_the_formula():
    field, depths = _scene()
    soft = jax.tree.map(np.asarray, _soft(field, depths))
    model = _model()
    np.testing.assert_allclose(soft.shares.sum(0), 1, rtol=1e-12)
    assert int(soft.number) == 2 * 3
    lab, depth = np.asarray(srgb_to_lab(field.centre_view)), np.asarray(depths.disparity[0, 0])
    side = np.sqrt(14 * 17 / 6)
    limit = float(model.limit)

    def cost(k, y, x):
        away = np.array([x, y]) - soft.xy[k]
        plane = float(soft.plane[k, 0] + soft.plane[k, 1:] @ away)
        colour = np.sum((lab[y, x] - soft.lab[k]) ** 2) / float(model.color) ** 2
        off = ((depth[y, x] - plane) / float(model.depth)) ** 2
        return away @ away / side**2 + sum(a / (1 + a / limit) for a in (colour, off))

    for y, x in ((0, 0), (7, 8), (13, 16)):
        share, names = np.asarray(soft.shares[:, y, x]), np.asarray(soft.names[:, y, x])
        used = share > 0
        costs = np.array([cost(k, y, x) for k in names[used]])
        wanted = np.exp(-costs / 0.5) / np.exp(-costs / 0.5).sum()
        np.testing.assert_allclose(share[used], wanted, rtol=1e-9)


def test_a_low_temperature_tells_surfaces_apart_and_leaves_means_unchanged():
    field, depths = _scene()
    soft = _soft(field, depths, temperature=0.01)
    best = np.asarray(soft.shares).argmax(0)[None]
    labels = np.take_along_axis(np.asarray(soft.names), best, axis=0)[0]
    near = np.arange(17) > 8
    assert not set(np.unique(labels[:, near])) & set(np.unique(labels[:, ~near]))
    flat = jnp.full((14, 17, 2), 0.3)
    np.testing.assert_allclose(through_superpixels(soft, flat), flat, rtol=1e-12)


@pytest.mark.parametrize("what", ["views", "depth", "params"])
def test_gradients_are_those_of_differences(what):
    field, depths = _scene()
    target = jnp.asarray(np.random.default_rng(1).normal(size=(14, 17, 3)))

    def loss(soft):
        found = through_superpixels(soft, target)
        return jnp.sum(jnp.sin(3 * found) * target) + jnp.sum(soft.plane[:6] ** 2)

    names = ("color", "depth", "limit", "slope", "temperature")
    cases = {
        "views": (
            field.views,
            lambda a: loss(_soft(eqx.tree_at(lambda f: f.views, field, a), depths)),
        ),
        "depth": (depths.disparity, lambda a: loss(_soft(field, depths._replace(disparity=a)))),
        "params": (
            jnp.stack([getattr(_model(), name) for name in names]),
            lambda a: loss(_soft(field, depths, **dict(zip(names, a, strict=True)))),
        ),
    }
    tree, function = cases[what]
    check_gradient(function, tree, rtol=1e-5, step=1e-6, key=jax.random.key(0))
