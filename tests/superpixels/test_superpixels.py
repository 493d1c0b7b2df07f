"""Superpixels: connected, on one surface, the same in all views; any grid of views."""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import shared_data
from skimage import measure

from mvedge_jax.all_views import ViewDepth, ViewDepths, depth_of_views
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics.superpixels import superpixel_scores
from mvedge_jax.superpixels import SuperpixelClustering, soft_superpixels, superpixels
from mvedge_jax.superpixels._views import _filled, whole

_NEAR, _FAR = 1.0, -1.0
_LABEL: Any = measure.label


def _cards(shape=(3, 3, 36, 44), dtype: Any = np.float32, pole=False):
    """A card, or a pole, before a wall, at whole disparities: true depth, colours, ids."""
    rows, columns, height, width = shape
    y, x = np.mgrid[:height, :width]
    disparity = np.zeros(shape)
    for v, u in np.ndindex(rows, columns):
        a, b = columns // 2 - u, rows // 2 - v
        row, column = y - b * _NEAR, x - a * _NEAR
        on = (np.abs(row - height // 2) < height // 4) & (np.abs(column - width // 2) < width // 4)
        if pole:
            on = np.abs(column - width // 2) < 2
        disparity[v, u] = np.where(on, _NEAR, _FAR)
    near = disparity > 0
    views = np.where(near[..., None], [0.5, 0.3, 0.2], [0.3, 0.4, 0.6])
    field = LightField(jnp.asarray(views, dtype))
    maps = jnp.asarray(disparity, dtype)
    depths = ViewDepths(maps, 0 * maps, jnp.zeros(shape, jnp.int8), jnp.asarray(0))
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
    assert float(scores.unlabelled) == 0
    assert float(scores.inconsistent) < 0.002
    wanted = shape[2] * shape[3] / 64
    assert abs(int(found.number) / wanted - 1) < 0.4
    for view in np.asarray(found.labels).reshape(-1, *shape[2:]):
        assert _LABEL(view, connectivity=1).max() == len(np.unique(view))


def test_a_pole_is_apart_from_the_wall_and_cuts_it():
    field, depths, ids = _cards(pole=True)
    found = _found(field, depths)
    centre = np.asarray(found.labels[1, 1])
    pole, wall = (set(np.unique(centre[ids[1, 1] == k])) for k in (1, 0))
    assert not pole & wall
    left, right = centre[:, :20], centre[:, 25:]
    assert not set(np.unique(left)) & set(np.unique(right))


def test_tables_tell_what_the_labels_show():
    field, depths, _ = _cards()
    found = _found(field, depths)
    centre = np.asarray(found.labels[1, 1])
    count = int(found.number)
    y, x = np.mgrid[: centre.shape[0], : centre.shape[1]]
    assert int(found.valid.sum()) == count
    for k in range(count):
        here = centre == k + 1
        assert here.sum() == int(found.area[k])
        if not here.any():
            continue
        np.testing.assert_allclose(found.xy[k], [x[here].mean(), y[here].mean()], rtol=1e-5)
        depth = np.asarray(depths.disparity[1, 1])[here]
        np.testing.assert_allclose(found.plane[k], [depth.mean(), 0, 0], atol=1e-4)
        picture = np.asarray(field.centre_view)[here]
        np.testing.assert_allclose(found.colour[k], picture.mean(0), rtol=1e-5)
    pairs = {
        (min(p, q), max(p, q))
        for one, two in ((centre[:, 1:], centre[:, :-1]), (centre[1:], centre[:-1]))
        for p, q in zip(one.ravel(), two.ravel(), strict=True)
        if p != q
    }
    rows = np.asarray(found.neighbours)
    assert {tuple(r) for r in rows[rows[:, 0] > 0].tolist()} == pairs
    # Card and wall: two parents, in the centre view.
    depth = np.asarray(depths.disparity[1, 1])
    parents = np.asarray(found.parents)[centre - 1]
    assert len(np.unique(parents)) == 2
    assert len(np.unique(parents[depth > 0])) == 1


def _one_view(disparity, views: Any = 0.5):
    """Depths and colours of 64x64 pixels, for one program of all such tests."""
    maps = jnp.asarray(disparity, jnp.float32)[None, None]
    depths = ViewDepths(maps, 0 * maps, jnp.zeros(maps.shape, jnp.int8), jnp.asarray(0))
    views = jnp.broadcast_to(jnp.asarray(views, jnp.float32), (1, 1, 64, 64, 3))
    return LightField(views), depths


def _found_in_one_view(field, depths, size):
    return _found(field, depths, size, attempts=4, capacity=256)


def test_slanted_planes_are_found():
    y, x = np.mgrid[:64, :64]
    found = _found_in_one_view(*_one_view(0.03 * x - 0.02 * y), 8.0)
    count = int(found.number)
    large = np.asarray(found.area)[:count] > 40
    slopes = np.asarray(found.plane)[:count, 1:][large]
    # The prior holds slopes back a little.
    np.testing.assert_allclose(slopes, np.broadcast_to([0.03, -0.02], slopes.shape), rtol=0.1)
    assert len(np.unique(np.asarray(found.parents)[:count])) == 1


@pytest.mark.parametrize("size", [8.0, 12.0])
def test_the_size_sets_the_number(size):
    field, depths, _ = _cards((1, 1, 64, 64))
    noise = 0.05 * np.random.default_rng(0).normal(size=field.views.shape)
    noisy = np.clip(np.asarray(field.views) + noise, 0, 1)
    found = _found_in_one_view(*_one_view(depths.disparity[0, 0], noisy), size)
    assert abs(int(found.number) * size**2 / 64**2 - 1) < 0.15


@pytest.mark.parametrize("size", [9.0, 10.0, 11.0])
def test_of_many_pieces_of_one_area_only_as_many_join_as_are_too_many(size):
    # Blocks of one size, each of a colour of its own: hundreds of pieces of 36 px.
    colours = np.random.default_rng(0).random((16, 16, 3)) * 0.3
    field, depths, _ = _cards((1, 1, 96, 96))
    views = 0.6 * np.asarray(field.views) + np.kron(colours, np.ones((6, 6, 1)))
    field = LightField(jnp.asarray(views, jnp.float32))
    found = _found(field, depths, size, rounds=6, attempts=4, capacity=512)
    assert abs(int(found.number) - 96**2 / size**2) <= 1


def test_wide_gaps_are_filled_from_the_surface_behind():
    labels = jnp.asarray([[1] + 10 * [0] + [2], 12 * [0]], jnp.int32)
    disparity = jnp.asarray([6 * [2.0] + 6 * [1.0], 12 * [jnp.nan]], jnp.float32)
    # Three pixels from either side by what is similar; the middle from what lies behind.
    expected = [4 * [1] + 8 * [2], 12 * [0]]
    assert _filled(labels, disparity).tolist() == expected
    assert jax.jit(_filled)(labels, disparity).tolist() == expected
    narrow = labels.at[0, 1:5].set(1).at[0, 7:].set(2)
    assert _filled(narrow, disparity).tolist() == [6 * [1] + 6 * [2], 12 * [0]]


def test_many_small_surfaces_do_not_make_the_others_large():
    y, x = np.mgrid[:64, :64]
    spots = (np.abs(y % 8 - 3) < 2) & (np.abs(x % 8 - 3) < 2) & (x < 40)
    found = _found_in_one_view(*_one_view(np.where(spots, 1.0, 0.0)), 16.0)
    # Forty spots are many more than the sixteen that such a size aims at; the wall between them
    # is still cut into cells of at most one and a half times the size.
    wall = np.asarray(found.labels[0, 0])[~spots]
    assert len(np.unique(wall)) >= wall.size / (1.5 * 16) ** 2 - 1
    assert int(found.number) == 40 + len(np.unique(wall))
    assert int(found.area.max()) < 4 * 16**2


def test_what_changes_no_label():
    """Another run, noise in another view than the centre, a view that is missing."""
    field, depths, _ = _cards()
    labels, before = _found(field, depths).labels, superpixels.traces
    noise = 0.02 * np.random.default_rng(3).normal(size=(36, 44, 3))
    noisy = field.views.at[0, 0].add(jnp.asarray(noise, jnp.float32))
    for views in (field.views, noisy):
        np.testing.assert_array_equal(_found(LightField(views), depths).labels, labels)
    assert int(_found(field, depths, 11.0).number) < int(labels.max())
    assert superpixels.traces == before
    available = jnp.ones((3, 3), bool).at[0, 0].set(False)
    part = LightField(field.views.at[0, 0].set(0.0), available=available)
    np.testing.assert_array_equal(_found(part, depths).labels, labels)


def test_missing_views_do_not_darken_what_the_centre_view_hides():
    """A board right behind the card, as large as it is in the centre view."""
    field, depths, _ = _cards((5, 5, 36, 44))
    near = depths.disparity > 0
    board = ~near & near[2, 2][None, None]
    disparity = jnp.where(board, 0.0, depths.disparity)
    red = jnp.asarray([0.9, 0.1, 0.1], field.views.dtype)
    views = jnp.where(board[..., None], red, field.views)
    row = jnp.arange(5) == 2
    available = row[:, None] | row[None]
    field = LightField(jnp.where(available[..., None, None, None], views, 0), available=available)
    found = _found(field, depths._replace(disparity=disparity))
    hidden = np.flatnonzero(np.asarray(found.valid & (found.area == 0)))
    assert hidden.size > 0
    there = np.asarray(available)
    labels, colours = np.asarray(found.labels)[there], np.asarray(field.views)[there]
    for k in hidden:
        np.testing.assert_allclose(found.colour[k], colours[labels == k + 1].mean(0), rtol=1e-5)


@pytest.mark.parametrize("fragment", [1.0, 4.0, 12.0])
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
    np.testing.assert_array_equal(found, wanted)


def test_overflow_is_counted_and_has_no_label():
    field, depths, _ = _cards((1, 3, 36, 44), pole=True)
    found = _found(field, depths, 8.0, capacity=5)
    assert int(found.number) > 5
    assert int(found.valid.sum()) == 5
    assert int(found.labels.max()) <= 5


def test_float64_labels_are_those_of_float32():
    one, two = (_found(*_cards(dtype=dtype)[:2]) for dtype in (np.float32, np.float64))
    assert float(jnp.mean(one.labels == two.labels)) > 0.95


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
