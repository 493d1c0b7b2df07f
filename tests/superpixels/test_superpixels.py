"""Superpixels: connected, on one surface, the same in all views; any grid of views."""

import inspect
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, shared_data
from numpy.testing import assert_allclose, assert_array_equal
from skimage import measure

from experiments._superpixels import changed, torn
from mvedge_jax.all_views import ViewDepth, ViewDepths, depth_of_views
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics.superpixels import superpixel_scores
from mvedge_jax.superpixels import (
    SuperpixelClustering,
    soft_superpixels,
    superpixels,
    through_superpixels,
)
from mvedge_jax.superpixels._views import _filled, whole

_NEAR, _FAR = 1.0, -1.0
_LABEL: Any = measure.label


def _depths(disparity):
    return ViewDepths(
        disparity, 0 * disparity, jnp.zeros(disparity.shape, jnp.int8), jnp.asarray(0)
    )


def _cards(shape=(3, 3, 36, 44)):
    """A card before a wall, at whole disparities: true depth, colors, ids."""
    rows, columns, height, width = shape
    y, x = np.mgrid[:height, :width] - np.array([height // 2, width // 2])[:, None, None]
    near = np.zeros(shape, bool)
    for v, u in np.ndindex(rows, columns):
        a, b = (columns // 2 - u) * _NEAR, (rows // 2 - v) * _NEAR
        near[v, u] = (np.abs(y - b) < height // 4) & (np.abs(x - a) < width // 4)
    views = np.where(near[..., None], [0.5, 0.3, 0.2], [0.3, 0.4, 0.6])
    field = LightField(jnp.asarray(views, jnp.float32))
    depths = _depths(jnp.asarray(np.where(near, _NEAR, _FAR), jnp.float32))
    return field, depths, near.astype(int)


def _found(field, depths, size=8.0, **choices):
    choices = {"size": size, "rounds": 3, "attempts": 2, **choices}
    return superpixels(field, depths, SuperpixelClustering.for_depths(depths, choices=choices))


@pytest.mark.parametrize("shape", [(3, 3, 36, 44), (1, 5, 30, 33)])
def test_superpixels_keep_to_surfaces_and_agree_in_all_views(shape):
    field, depths, ids = _cards(shape)
    found = _found(field, depths)
    scores = superpixel_scores(found.labels, jnp.asarray(ids), depths.disparity)
    assert float(scores.accuracy) == 1
    assert float(scores.unlabeled) == 0
    assert float(scores.inconsistent) < 0.002
    wanted = shape[2] * shape[3] / 64
    assert abs(int(found.number) / wanted - 1) < 0.4
    for view in np.asarray(found.labels).reshape(-1, *shape[2:]):
        assert _LABEL(view, connectivity=1).max() == len(np.unique(view))


def test_tables_tell_what_the_labels_show():
    field, depths, _ = _cards()
    found = jax.tree.map(np.asarray, _found(field, depths))
    center, depth = found.labels[1, 1], np.asarray(depths.disparity[1, 1])
    y, x = np.mgrid[: center.shape[0], : center.shape[1]]
    assert found.valid.sum() == found.number
    for k in range(found.number):
        here = center == k + 1
        assert here.sum() == found.area[k]
        if here.any():
            assert_allclose(found.xy[k], [x[here].mean(), y[here].mean()], rtol=1e-5)
            assert_allclose(found.plane[k], [depth[here].mean(), 0, 0], atol=1e-4)
            assert_allclose(found.color[k], np.asarray(field.center_view)[here].mean(0), rtol=1e-5)
    beside = ((center[:, 1:], center[:, :-1]), (center[1:], center[:-1]))
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in beside])
    pairs = {(min(p), max(p)) for p in pairs.tolist() if p[0] != p[1]}
    assert {tuple(row) for row in found.neighbors.tolist() if row[0] > 0} == pairs
    # Card and wall: two parents, in the center view.
    parents = found.parents[center - 1]
    assert len(np.unique(parents)) == 2
    assert len(np.unique(parents[depth > 0])) == 1


def _in_one_view(disparity, size, views: Any = 0.5):
    """Of 64x64 pixels, by one program for all such tests."""
    depths = _depths(jnp.asarray(disparity, jnp.float32)[None, None])
    views = jnp.broadcast_to(jnp.asarray(views, jnp.float32), (1, 1, 64, 64, 3))
    return _found(LightField(views), depths, size, attempts=4, capacity=256)


def test_slanted_planes_are_found():
    y, x = np.mgrid[:64, :64]
    found = _in_one_view(0.03 * x - 0.02 * y, 8.0)
    count = int(found.number)
    large = np.asarray(found.area)[:count] > 40
    slopes = np.asarray(found.plane)[:count, 1:][large]
    # The prior holds slopes back a little.
    assert_allclose(slopes, np.broadcast_to([0.03, -0.02], slopes.shape), rtol=0.1)
    assert len(np.unique(np.asarray(found.parents)[:count])) == 1


@pytest.mark.parametrize("size", [8.0, 12.0])
def test_the_size_sets_the_number(size):
    field, depths, _ = _cards((1, 1, 64, 64))
    noise = 0.05 * np.random.default_rng(0).normal(size=field.views.shape)
    noisy = np.clip(np.asarray(field.views) + noise, 0, 1)
    found = _in_one_view(depths.disparity[0, 0], size, noisy)
    assert abs(int(found.number) * size**2 / 64**2 - 1) < 0.15


def test_wide_gaps_are_filled_from_the_surface_behind():
    labels = jnp.asarray([[1] + 10 * [0] + [2], 12 * [0]], jnp.int32)
    disparity = jnp.asarray([6 * [2.0] + 6 * [1.0], 12 * [jnp.nan]], jnp.float32)
    # Three pixels from either side by what is similar; the middle from what lies behind.
    expected = [4 * [1] + 8 * [2], 12 * [0]]
    assert _filled(labels, disparity).tolist() == expected
    assert jax.jit(_filled)(labels, disparity).tolist() == expected
    narrow = labels.at[0, 1:5].set(1).at[0, 7:].set(2)
    assert _filled(narrow, disparity).tolist() == [6 * [1] + 6 * [2], 12 * [0]]


def test_overflow_is_counted_and_has_no_label():
    y, x = np.mgrid[:64, :64]
    # More fields than there are slots, each a surface of its own.
    found = _in_one_view((y // 3 + x // 3) % 2, 8.0)
    assert int(found.number) > 256
    assert int(found.valid.sum()) == int(found.labels.max()) == 256


def test_what_changes_no_label():
    """Another run, noise in another view than the center, a view that is missing."""
    field, depths, _ = _cards()
    labels, before = _found(field, depths).labels, superpixels.traces
    noise = 0.02 * np.random.default_rng(3).normal(size=(36, 44, 3))
    noisy = field.views.at[0, 0].add(jnp.asarray(noise, jnp.float32))
    for views in (field.views, noisy):
        assert_array_equal(_found(LightField(views), depths).labels, labels)
    assert int(_found(field, depths, 11.0).number) < int(labels.max())
    assert superpixels.traces == before
    available = jnp.ones((3, 3), bool).at[0, 0].set(False)
    part = LightField(field.views.at[0, 0].set(0.0), available=available)
    assert_array_equal(_found(part, depths).labels, labels)


@pytest.mark.parametrize("fragment", [1.0, 12.0])
def test_fragments_join_what_is_closest_in_disparity(fragment):
    rng = np.random.default_rng(2)
    labels = np.kron(rng.integers(1, 5, (6, 7)), np.ones((4, 4), int))
    speckled = rng.random(labels.shape) < 0.2
    labels[speckled] = rng.integers(1, 5, speckled.sum())
    disparity = rng.normal(size=labels.shape)
    found = whole(jnp.asarray(labels, jnp.int32), jnp.asarray(disparity), jnp.asarray(fragment), 5)
    wanted, apart = labels.copy(), np.zeros(labels.shape, bool)
    pieces = []
    for name in np.unique(labels):
        numbers, count = _LABEL(labels == name, connectivity=1, return_num=True)
        areas = np.bincount(numbers.ravel())
        for k in range(1, count + 1):
            if areas[k] < fragment and areas[k] < areas[1:].max():
                pieces.append(numbers == k)
                apart |= numbers == k
    for piece in pieces:
        options = []
        for y, x in zip(*np.nonzero(piece), strict=True):
            for b, a in ((y, x + 1), (y, x - 1), (y + 1, x), (y - 1, x)):
                inside = 0 <= b < labels.shape[0] and 0 <= a < labels.shape[1]
                if inside and not apart[b, a]:
                    options.append((abs(disparity[b, a] - disparity[y, x]), labels[b, a]))
        if options:
            wanted[piece] = min(options)[1]
    assert_array_equal(found, wanted)


def test_bad_input_is_named():
    field, depths, _ = _cards()
    other = depths._replace(disparity=depths.disparity[:, :, :5])
    model = SuperpixelClustering.for_depths(depths)
    assert "size = 20 px" in str(model)
    with pytest.raises(ValueError, match="`depths` must have the shape of the views"):
        inspect.unwrap(superpixels)(field, other, model)
    with pytest.raises(ValueError, match="`capacity` must be at least 1, got 0"):
        SuperpixelClustering(capacity=0, margin=1)
    with pytest.raises(ValueError, match="`capacity` must be at most"):
        SuperpixelClustering(capacity=100_000, margin=1)
    for function in (superpixels, soft_superpixels):
        for name, value in (("size", 0.0), ("size", -20.0), ("temperature", 0.0)):
            with pytest.raises(ValueError, match=f"`{name}` must be"):
                function(field, depths, model.replace({name: value}))
        with pytest.raises(TypeError, match="`model` must be SuperpixelClustering, got ViewDepths"):
            function(field, depths, depths)
    with pytest.raises(ValueError, match="`colour` is no path of `SuperpixelClustering`"):
        model.replace(colour=7.0)


@pytest.mark.slow
def test_cotton_is_cut_along_its_objects():
    scene = load_light_field(shared_data("hci", "cotton"), views=5).downsample(4)
    blind = scene.without_truth()
    result = EdgeDepth.for_light_field(blind)(blind)
    depths = depth_of_views(blind, result, ViewDepth.for_light_field(blind))
    model = SuperpixelClustering.for_depths(depths, choices={"size": 10.0})
    found = superpixels(blind, depths, model)
    labels = np.asarray(found.labels)
    assert (labels > 0).all()
    assert abs(len(np.unique(labels[2, 2])) / (128**2 / 100) - 1) < 0.05
    truth = scene.truth
    assert truth is not None
    assert truth.object_ids is not None
    scores = superpixel_scores(jnp.asarray(labels[2:3, 2:3]), truth.object_ids[None, None], None)
    assert float(scores.accuracy) > 0.98
    assert float(scores.compactness) > 0.4


def test_pieces_are_torn_unless_something_in_front_or_the_frame_keeps_them_apart():
    labels = np.full((1, 1, 6, 9), 3)
    labels[..., 1:5, 1:8] = 1
    labels[..., 1:5, 3:5] = 2
    disparity = np.zeros(labels.shape)
    disparity[..., 1:5, 3:5] = 1.0
    for depth, share in ((0 * disparity, 1 / 3), (disparity, 0), (-disparity, 1 / 3)):
        assert torn(labels, depth) == pytest.approx(share)
    labels = np.full((1, 1, 6, 9), 5)
    labels[..., 2:, 3:6] = labels[..., :2, :] = 8
    assert torn(labels, 0 * disparity) == 0


def test_other_numbers_of_the_same_superpixels_are_no_change():
    labels = np.repeat(np.arange(1, 5), 6).reshape(1, 1, 4, 6)
    assert changed(labels, 9 - labels) == 0
    others = labels.copy()
    others[..., 0, :2] = 2
    assert changed(labels, others) == pytest.approx(2 / 24)


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
    assert_allclose(soft.shares.sum(0), 1, rtol=1e-12)
    assert int(soft.number) == 2 * 3
    lab, depth = np.asarray(srgb_to_lab(field.center_view)), np.asarray(depths.disparity[0, 0])
    side = np.sqrt(14 * 17 / 6)
    limit = float(model.limit)

    def cost(k, y, x):
        away = np.array([x, y]) - soft.xy[k]
        plane = float(soft.plane[k, 0] + soft.plane[k, 1:] @ away)
        color = np.sum((lab[y, x] - soft.lab[k]) ** 2) / float(model.color) ** 2
        off = ((depth[y, x] - plane) / float(model.depth)) ** 2
        return away @ away / side**2 + sum(a / (1 + a / limit) for a in (color, off))

    for y, x in ((0, 0), (7, 8), (13, 16)):
        share, names = np.asarray(soft.shares[:, y, x]), np.asarray(soft.names[:, y, x])
        used = share > 0
        costs = np.array([cost(k, y, x) for k in names[used]])
        wanted = np.exp(-costs / 0.5) / np.exp(-costs / 0.5).sum()
        assert_allclose(share[used], wanted, rtol=1e-9)


def test_a_low_temperature_tells_surfaces_apart_and_leaves_means_unchanged():
    field, depths = _scene()
    soft = _soft(field, depths, temperature=0.01)
    best = np.asarray(soft.shares).argmax(0)[None]
    labels = np.take_along_axis(np.asarray(soft.names), best, axis=0)[0]
    near = np.arange(17) > 8
    assert not set(np.unique(labels[:, near])) & set(np.unique(labels[:, ~near]))
    flat = jnp.full((14, 17, 2), 0.3)
    assert_allclose(through_superpixels(soft, flat), flat, rtol=1e-12)


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
