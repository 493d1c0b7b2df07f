"""The thesis' own chain: points, their sides, depth from points alone."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from centre.derivatives import check_rows, noisy_scene
from edges.scenes import plane

from mvedge_jax._crosshair import crosshair
from mvedge_jax.baselines import (
    SparseParams,
    SparseSizes,
    ThesisParams,
    ThesisSizes,
    sparse_depth,
    thesis_depth,
    thesis_edges,
)
from mvedge_jax.baselines._reprojection import reprojection_score
from mvedge_jax.baselines._sparse_depth import point_weight, thesis_response
from mvedge_jax.datasets import synthetic
from mvedge_jax.edges import EdgeParams, EdgePoints, EdgeSizes, multiview_edges
from mvedge_jax.epi import FilterBank
from mvedge_jax.lightfield import LightField

_SMALL = {"levels": 16, "median_radius": 3}


def _points(xy, disparity, normal):
    count = len(disparity)
    return EdgePoints(
        xy=jnp.asarray(xy, float).reshape(count, 2),
        disparity=jnp.asarray(disparity, float),
        confidence=jnp.full(count, 0.5),
        error=jnp.full(count, 0.005),
        normal=jnp.asarray(normal, float).reshape(count, 2),
        visible=jnp.ones((count, 6), bool),
        valid=jnp.ones(count, bool),
    )


@pytest.mark.slow
def test_points_of_a_plane():
    light_field = plane(0.37, views=9, size=(16, 40))
    sizes = ThesisSizes(reach=0.7, capacity=512, filters=16, lines=16)
    edges = thesis_edges(light_field, ThesisParams(), sizes, key=jax.random.key(0))
    keep = np.asarray(edges.points.valid)
    error = np.abs(np.asarray(edges.points.disparity)[keep] - 0.37)
    assert keep.sum() > 50
    assert int(edges.stats.candidates) >= int(edges.stats.consistent) >= keep.sum()
    # Half the spacing of the filters, and hardly an outlier.
    assert np.median(error) < 0.05
    assert np.mean(error < 0.15) > 0.95
    assert not np.asarray(edges.points.disparity)[~keep].any()


def test_taps_reach_the_disparities_of_points_between_filters():
    blind = noisy_scene("edges", 40)
    sizes = ThesisSizes.for_light_field(blind, interpolate=True, lines=32)
    banks = sizes.banks(blind.views.shape, blind.views.dtype)

    def loss(banks):
        points = thesis_edges(blind, ThesisParams(banks=banks), sizes, key=jax.random.key(3)).points
        return jnp.where(points.valid, jnp.sin(3 * points.disparity + points.xy[:, 0]), 0).sum()

    taps = [bank.taps for bank in banks]
    zero = [jnp.zeros_like(bank.disparity) for bank in banks]
    directions = [
        jnp.asarray(np.random.default_rng(k).normal(size=t.shape)) for k, t in enumerate(taps)
    ]
    tangent = tuple(FilterBank(*pair) for pair in zip(zero, directions, strict=True))

    def along(step):
        return jax.tree.map(lambda leaf, change: leaf + step * change, banks, tangent)

    slopes = jax.grad(loss)(banks)
    slope = sum(
        jnp.vdot(s.taps, direction) for s, direction in zip(slopes, directions, strict=True)
    )
    numeric = (loss(along(1e-8)) - loss(along(-1e-8))) / 2e-8
    assert abs(float(slope)) > 1
    np.testing.assert_allclose(slope, numeric, rtol=1e-3)


def test_a_bank_for_other_views_is_refused():
    light_field = plane(0.37, views=9, size=(16, 16))
    sizes = ThesisSizes(reach=0.7, capacity=64)
    with pytest.raises(ValueError, match="`bank` is for 5 views, `arm` has 9"):
        thesis_edges(
            light_field, ThesisParams(banks=sizes.banks((5, 5))), sizes, key=jax.random.key(0)
        )


def test_sizes_that_cannot_be_are_refused():
    light_field = plane(0.37, size=(16, 16))
    sizes = ThesisSizes(reach=0.7, capacity=64)
    with pytest.raises(ValueError, match=r"`key` must be given for the entropy search"):
        thesis_edges(light_field, ThesisParams(), sizes)
    for change, message in (
        ({"lines": 0}, "`lines` must be positive, got 0"),
        ({"levels": 3}, "`levels` must be 1 or 2, got 3"),
        ({"filters": 3}, "`filters` must be at least 4, got 3"),
        ({"reach": 0.0}, "`reach` must be positive, got 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(sizes, **change)
    # Past the annotations, which are checked in tests only.
    wrong = SparseSizes(radius=3)
    object.__setattr__(wrong, "side", "left")
    with pytest.raises(ValueError, match="`side` must be one of .*'left'"):
        wrong.__post_init__()
    with pytest.raises(ValueError, match="`solves` must be at least 1, got 0"):
        SparseSizes(radius=3, solves=0)


@pytest.fixture(scope="module")
def scene():
    """A rendered scene with depth edges, and our points in it."""
    light_field = synthetic.render(
        synthetic.scene("edges"), shape=(5, 5, 48, 56), samples=2, key=jax.random.key(0)
    )
    blind = light_field.without_truth()
    points = multiview_edges(blind, EdgeParams(), EdgeSizes.for_light_field(blind)).points
    return light_field, points


@pytest.mark.parametrize("side", ["thesis", "bidirectional", "reprojection", "naive"])
def test_every_choice_of_side_gives_a_map(scene, side):
    light_field, points = scene
    sizes = SparseSizes.for_light_field(light_field, side=side, **_SMALL)
    found = sparse_depth(light_field.without_truth(), points, SparseParams(), sizes)
    error = np.abs(np.asarray(found.disparity) - np.asarray(light_field.truth.disparity))
    assert np.median(error) < 0.1
    assert bool(found.converged)
    assert bool((found.surface.score == 0).all()) == (side == "naive")


@pytest.mark.slow
def test_the_whole_chain_is_its_two_parts(scene):
    light_field = scene[0].without_truth()
    sizes = (
        ThesisSizes.for_light_field(light_field, lines=32),
        SparseSizes.for_light_field(light_field, **_SMALL),
    )
    params, key = (ThesisParams(), SparseParams()), jax.random.key(0)
    found = thesis_depth(light_field, params, sizes, key=key)
    points = thesis_edges(light_field, params[0], sizes[0], key=key).points
    apart = sparse_depth(light_field, points, params[1], sizes[1])
    np.testing.assert_array_equal(found.disparity, apart.disparity)
    # Points lie beside what they belong to: the best of the 3x3 pixels around each.
    keep, truth = np.asarray(points.valid), np.asarray(scene[0].truth.disparity)
    x, y = np.clip(np.rint(np.asarray(points.xy)[keep]).astype(int).T, 0, [[55], [47]])
    around = [np.pad(truth, 1, mode="edge")[y + j, x + i] for j in range(3) for i in range(3)]
    error = np.abs(np.asarray(points.disparity)[keep] - np.stack(around)).min(0)
    assert keep.sum() > 300
    assert np.median(error) < 0.01


def test_profiles_are_stretched_before_the_thesis_filter_answers():
    before = jnp.array([0.0, 0, 0, 1, 1, 1, 1])[:, None]
    flat = jnp.full((7, 1), 0.4)
    found = thesis_response(jnp.concatenate([0.003 * before, -0.6 * before, flat], 1))
    np.testing.assert_allclose(found, [4.0, 4.0, 0.0], atol=1e-9)


def test_weights_grow_with_the_confidence_up_to_the_limit():
    points = _points([(1, 1)] * 3, [0.0] * 3, [(1, 0)] * 3)
    found = np.asarray(point_weight(jnp.array([0.0, 1.0, 50.0]), points, SparseParams()))
    # The points' standard error is the one at which a label counts half.
    expected = 0.25 * (1 + np.exp([-4.0, -1.0, 0.0]))
    np.testing.assert_allclose(found, expected)


def test_reprojection_prefers_the_map_that_explains_the_views():
    rng = np.random.default_rng(0)
    texture = np.kron(rng.uniform(size=(20, 30)), np.ones((1, 1)))
    views = np.zeros((3, 3, 20, 24, 3))
    for v, u in np.ndindex(3, 3):
        # Disparity 1: a point at x is at x + (1 - u).
        views[v, u] = np.roll(texture, (1 - v, 1 - u), (0, 1))[:, 3:27, None]
    horizontal, vertical = crosshair(LightField(jnp.asarray(views)))
    points = _points([(10, 9), (14, 6)], [1.0, 1.0], [(1, 0), (0, 1)])
    right, wrong = jnp.ones((20, 24)), jnp.zeros((20, 24))
    score = reprojection_score(points, right, wrong, horizontal, vertical, radius=2)
    assert (np.asarray(score) > 0.05).all()


SCENES = pytest.mark.parametrize("name", ["edges", "demo"])
SIDES = pytest.mark.parametrize("size", [40, 64, 96])
# What only selects: the pixel of a label, a bound that is not reached, which side is chosen.
_SELECT = {
    "bidirectional.offset",
    "bidirectional.floor",
    *(
        f"surface.{name}"
        for name in ("offset", "response", "neighbours", "dense", "radius", "cap", "temperature")
    ),
}
# The same of lines: which are found, how far apart, which are kept.
_LINES = {"floor", "smoothing", "suppression", "vote"}


def _mean_sine(disparity, size):
    phase = jax.random.normal(jax.random.key(5), (size, size), disparity.dtype)
    return jnp.mean(jnp.sin(3 * disparity + phase))


@pytest.mark.parametrize(
    ("name", "size"),
    [
        pytest.param(name, size, marks=[] if (name, size) == ("edges", 40) else [pytest.mark.slow])
        for name in ("edges", "demo")
        for size in (40, 64, 96)
    ],
)
def test_every_leaf_of_depth_from_points(name, size):
    blind = noisy_scene(name, size)
    sizes = SparseSizes.for_light_field(blind, side="bidirectional", tolerance=1e-12)
    found = multiview_edges(blind, EdgeParams(), EdgeSizes.for_light_field(blind)).points

    def loss(tree):
        (params, error), views = tree
        field = LightField(views, disparity_range=blind.disparity_range)
        points = eqx.tree_at(lambda p: p.error, found, error)
        return _mean_sine(sparse_depth(field, points, params, sizes).disparity, size)

    # Of points that share a pixel one is chosen: their places and disparities are left alone.
    zero = {f"[0].{n}" for n in _SELECT}
    check_rows(loss, (SparseParams(), found.error), blind.views, zero, directions=1)


@pytest.mark.slow
@SCENES
@SIDES
def test_every_leaf_of_the_thesis_chain(name, size):
    blind = noisy_scene(name, size)
    sizes = (
        ThesisSizes.for_light_field(blind),
        SparseSizes.for_light_field(blind, tolerance=1e-12),
    )

    def loss(tree):
        params, views = tree
        field = LightField(views, disparity_range=blind.disparity_range)
        found = thesis_depth(field, params, sizes, key=jax.random.key(3))
        return _mean_sine(found.disparity, size)

    zero = {f"[0].{n}" for n in _LINES} | {f"[1].{n}" for n in _SELECT}
    check_rows(loss, (ThesisParams(), SparseParams()), blind.views, zero, directions=1)
