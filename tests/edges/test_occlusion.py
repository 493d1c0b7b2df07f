"""Surface vectors, depth-edge confidence, and what they are made from."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, check_modes
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import EdgePoints, rasterize, share
from mvedge_jax.edges.sides import (
    DirectionalDiffusion,
    SideVote,
    ThesisSides,
    bidirectional,
    depth_edge_confidence,
    step_response,
    surface_vectors,
    thesis_response,
)
from mvedge_jax.edges.sides._profile import profiles
from mvedge_jax.edges.sides._surface import along_edge
from mvedge_jax.photometry.measuring import visible_view_range

SHAPE = (24, 32)
EDGE = 16  # first column of the near surface in `square_wave`
TRUTH = np.broadcast_to(np.where(np.arange(SHAPE[1]) < EDGE, 0.0, 1.0), SHAPE)


def make_points(xy, disparity, normal, valid=None):
    count = len(disparity)
    return EdgePoints(
        xy=jnp.asarray(xy, float).reshape(count, 2),
        disparity=jnp.asarray(disparity, float),
        confidence=jnp.full(count, 0.5),
        error=jnp.full(count, 0.005),
        normal=jnp.asarray(normal, float).reshape(count, 2),
        visible=jnp.ones((count, 6), bool),
        valid=jnp.ones(count, bool) if valid is None else jnp.asarray(valid),
    )


def square_wave():
    """A near surface (d = 1) right of a depth edge over a far one (d = 0), with texture on both.

    The edge's own points carry the near disparity, their normals alternate in sign; texture lines
    at other columns carry the disparity of their own surface.
    """
    columns = ((4, 0.0), (9, 0.0), (EDGE - 0.4, 1.0), (22, 1.0), (28, 1.0))
    xy = [(column, row) for column, _ in columns for row in range(2, 22)]
    disparity = [d for _, d in columns for _ in range(2, 22)]
    normal = [(1.0 if row % 2 else -1.0, 0.0) for _, row in xy]
    gray = np.full(SHAPE, 0.3)
    gray[:, EDGE:] = 0.7
    for column in (4, 9, 22, 28):
        gray[:, column:] += 0.05
    return make_points(xy, disparity, normal), jnp.asarray(gray)


POINTS, GRAY = square_wave()
AT_EDGE = np.abs(np.asarray(POINTS.xy[:, 0]) - (EDGE - 0.4)) < 0.05


@pytest.fixture(scope="module")
def passes():
    return bidirectional(POINTS, GRAY, DirectionalDiffusion())


def test_rasterize_keeps_the_nearest_surface_and_drops_what_is_outside():
    xy = [(1.2, 2.4), (0.8, 1.6), (5.0, 1.0), (-3.0, 0.0), (2.0, 0.0)]
    points = make_points(xy, [0.5, 0.9, -1.0, 3.0, 7.0], [(1, 0)] * 5, [True] * 4 + [False])
    raster = rasterize(points.xy, points.disparity, points.valid, (4, 6))
    expected = np.zeros((4, 6))
    expected[2, 1], expected[1, 5] = 0.9, -1.0
    assert_array_equal(raster.values(points.disparity), expected)
    assert int(raster.hit.sum()) == 2


@pytest.mark.parametrize("taps", [(-1.0, -1.5, -2.0, 2.0, 1.5, 1.0), (-1.0, -1.0, 1.0, 1.0)])
def test_step_response_is_twice_the_step_and_zero_when_flat(taps):
    before = jnp.array([0.0, 0, 0, 1, 1, 1, 1])[:, None] * 0.3
    after = jnp.array([0.0, 0, 0, 0, 1, 1, 1])[:, None] * -0.3
    flat = jnp.full((7, 1), 0.4)
    for profile, height in ((before, 0.6), (after, 0.6), (flat, 0.0)):
        assert float(step_response(profile, taps=taps)[0]) == pytest.approx(height, abs=1e-12)
    # Profiles are stretched before the thesis' filter answers.
    found = thesis_response(jnp.concatenate([0.01 * before, -2 * before, flat], 1))
    assert_allclose(found, [4.0, 4.0, 0.0], atol=1e-9)


def test_profiles_of_a_plane_are_linear_along_the_normal():
    y, x = jnp.mgrid[0:20, 0:30].astype(float)
    place, normal = jnp.array([[12.3, 9.1]]), jnp.array([[0.6, 0.8]])
    found = profiles(0.1 * x - 0.2 * y, place, normal)[:, 0]
    middle = 0.1 * 12.3 - 0.2 * 9.1
    assert_allclose(found, middle + np.arange(-3, 4) * (0.06 - 0.16), atol=1e-12)


def test_bidirectional_diffusion_finds_the_near_side_of_an_occlusion_edge(passes):
    signs = np.sign(np.asarray(passes.response)) * np.asarray(POINTS.normal[:, 0])
    # The near surface is on the right; the ends of the edge see it only from one side.
    assert (signs[AT_EDGE] > 0).mean() >= 0.9
    # Both passes agree on the texture inside of a surface: little confidence there.
    confidence = np.asarray(passes.confidence)
    assert np.median(confidence[AT_EDGE]) > 10 * np.median(confidence[~AT_EDGE])
    profile = np.asarray(passes.edge)[8]
    assert abs(int(profile.argmax()) - (EDGE - 0.4)) <= 3
    assert profile.max() > 5 * np.median(profile)


def test_surface_vectors_move_labels_onto_their_surface(passes):
    for response, dense in ((passes.response, None), (None, None), (None, jnp.asarray(TRUTH))):
        surface = surface_vectors(POINTS, response, dense, SideVote(), shape=SHAPE)
        assert_allclose(surface.offset[AT_EDGE], [[1.0, 0.0]] * AT_EDGE.sum())


def test_along_edge_outvotes_a_lone_dissenter():
    sign = POINTS.normal[:, 0]
    score = sign.at[50].multiply(-1.0)
    assert AT_EDGE[50]
    smoothed = along_edge(POINTS, score, shape=SHAPE, reach=6)
    assert_array_equal(jnp.sign(smoothed), sign)
    assert_array_equal(along_edge(POINTS, score, shape=SHAPE, reach=0), score)


def test_no_points_at_all_is_a_flat_map():
    nothing = eqx.tree_at(lambda p: p.valid, POINTS, jnp.zeros_like(POINTS.valid))
    found = bidirectional(nothing, jnp.full(SHAPE, 0.5), DirectionalDiffusion())
    for image in (found.forward, found.backward, found.edge, found.response):
        assert_array_equal(image, 0)
    gradient = jax.grad(lambda d: depth_edge_confidence(d, d).sum())(jnp.zeros((4, 4)))
    assert bool(jnp.isfinite(gradient).all())


def test_gradient_of_the_passes_matches_differences():
    solver = AutoSolver(tolerance=jnp.asarray(1e-9))

    def loss(tree):
        disparity, logs = tree
        params = eqx.tree_at(lambda p: p.solver, jax.tree.map(jnp.exp, logs), solver)
        moved = make_points(POINTS.xy, disparity, POINTS.normal)
        passes = bidirectional(moved, GRAY, params)
        return jnp.sum(passes.confidence**2) + jnp.sum(passes.edge**2)

    spread = POINTS.disparity + 0.01 * jnp.sin(jnp.arange(POINTS.disparity.shape[0]))
    tree = (spread, jax.tree.map(jnp.log, DirectionalDiffusion()))
    check_gradient(loss, tree, rtol=1e-3, step=1e-6, key=jax.random.key(0))


def test_reach_agrees_with_brute_force():
    rng = np.random.default_rng(1)
    disparity = np.repeat(rng.uniform(-1, 1, (6, 8)), 4, axis=1)
    radius, least = 9, 0.05
    found = visible_view_range(jnp.asarray(disparity), radius=radius, step=least)
    expected = np.full((2, *disparity.shape), np.inf)
    for y, x in np.ndindex(disparity.shape):
        for j in range(1, radius + 1):
            for side, other in ((0, x + j), (1, x - j)):
                if 0 <= other < disparity.shape[1]:
                    rise = disparity[y, other] - disparity[y, x]
                    if rise > least:
                        expected[side, y, x] = min(expected[side, y, x], (j - 0.5) / rise)
    for negative_and_positive in zip(found, expected, strict=True):
        assert_allclose(*negative_and_positive)


def _minimum(weight, label, smoothness):
    """The map of least energy: every edge of the grid once, with the lesser of its two weights."""
    pixels = np.arange(weight.size).reshape(weight.shape)
    matrix = np.diag(weight.ravel())
    for one, other in ((pixels[:, :-1], pixels[:, 1:]), (pixels[:-1], pixels[1:])):
        for a, b in zip(one.ravel(), other.ravel(), strict=True):
            edge = np.zeros(weight.size)
            edge[[a, b]] = 1, -1
            matrix += min(smoothness.flat[a], smoothness.flat[b]) * np.outer(edge, edge)
    return np.linalg.solve(matrix, (weight * label).ravel()).reshape(weight.shape)


def test_both_passes_minimize_the_printed_energy():
    """Eq. 4.8 to 4.11 as printed (norms squared), against a dense system in loops."""
    rng, shape, count = np.random.default_rng(3), (9, 11), 14
    gray = np.where(np.arange(shape[1]) < 5, 0.2, 0.8) + 0.02 * rng.random(shape)
    xy = rng.uniform(-0.4, np.array(shape[::-1]) - 0.6, (count, 2))
    disparity, angle = rng.normal(size=count), rng.uniform(0, 2 * np.pi, count)
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    diffusion = ThesisSides.printed().diffusion
    diffusion = eqx.tree_at(lambda d: d.solver, diffusion, AutoSolver(tolerance=1e-9))
    assert diffusion.form == "inverse"
    found = bidirectional(make_points(xy, disparity, normal), jnp.asarray(gray), diffusion)
    # Central differences, borders repeated.
    wide = np.pad(gray, 1, mode="edge")
    across, down = wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]
    smoothness = 1 / (np.hypot(across, down) / 2 + 1e-4)
    for sign, passed in ((1, found.forward), (-1, found.backward)):
        weight, label = np.zeros(shape), np.full(shape, -np.inf)
        for place, value in zip(xy + sign * normal, disparity, strict=True):
            x, y = np.floor(place + 0.5).astype(int)
            if 0 <= x < shape[1] and 0 <= y < shape[0]:
                # Of several labels on one pixel, the nearest surface stays.
                weight[y, x], label[y, x] = 1e6, max(label[y, x], value)
        expected = _minimum(weight, np.where(weight > 0, label, 0), smoothness)
        assert_allclose(passed, expected, atol=1e-6)


_TOLERANCE = 0.2


@pytest.fixture
def labels():
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1.5, 8.5, (40, 2))
    disparity, weight = rng.normal(size=40), rng.uniform(0.1, 1, 40)
    weight[::7] = 0
    surface = 0.3 * rng.normal(size=(6, 8))
    return jnp.asarray(xy), jnp.asarray(disparity), jnp.asarray(weight), jnp.asarray(surface)


def test_shares_are_those_of_a_loop(labels):
    xy, disparity, weight, surface = map(np.asarray, labels)
    total, moved = np.zeros((6, 8)), np.zeros((6, 8))
    for (x, y), d, w in zip(xy, disparity, weight, strict=True):
        for row, column in np.ndindex(6, 8):
            bilinear = max(0, 1 - abs(x - column)) * max(0, 1 - abs(y - row))
            part = w * bilinear / (1 + ((d - surface[row, column]) / _TOLERANCE) ** 2) ** 2
            total[row, column] += part
            moved[row, column] += part * d
    found, mean = share(*labels, tolerance=jnp.asarray(_TOLERANCE))
    assert_allclose(found, total, atol=1e-12)
    hit = total > 1e-9
    assert_allclose(np.asarray(mean)[hit], moved[hit] / total[hit], atol=1e-9)
    empty = total == 0
    assert empty.any()
    assert_array_equal(np.asarray(mean)[empty], surface[empty])


def test_empty_slots_change_nothing_and_have_no_gradient(labels):
    xy, disparity, weight, surface = labels

    def loss(xy, disparity):
        total, mean = share(xy, disparity, weight, surface, jnp.asarray(_TOLERANCE))
        return jnp.sum(total * jnp.sin(mean))

    empty = weight == 0
    other = jnp.where(empty[:, None], 3.3, xy), jnp.where(empty, 0.1, disparity)
    assert float(loss(xy, disparity)) == float(loss(*other))
    gradient = jax.grad(loss, argnums=(0, 1))(*other)
    assert not np.asarray(gradient[0])[np.asarray(empty)].any()
    assert not np.asarray(gradient[1])[np.asarray(empty)].any()


def test_labels_of_next_to_no_weight_have_finite_derivatives_in_single_precision():
    # As of a side whose probability is e^-50: the square of its inverse is no number of float32.
    one = jnp.float32
    xy = jnp.asarray([[1.25, 1.0], [4.25, 1.0]], one)
    disparity, surface = jnp.asarray([0.1, 0.4], one), jnp.zeros((3, 6), one)

    def loss(*tree):
        total, mean = share(*tree)
        return jnp.sum(total * jnp.sin(mean))

    for least in (1e-22, 1e-37):
        weight = jnp.asarray([1, least], one)
        tree = xy, disparity, weight, surface, jnp.asarray(_TOLERANCE, one)
        for leaf in jax.grad(loss, argnums=tuple(range(5)))(*tree):
            assert np.isfinite(np.asarray(leaf)).all()
        total, mean = share(*tree)
        assert float(total[1, 1]) > 0.1
        assert not np.asarray(total[:, 4:]).any()
        assert not np.asarray(mean[:, 4:]).any()


def test_derivatives_in_positions_labels_weights_map_and_tolerance(labels):
    xy, disparity, weight, surface = labels
    weight = weight + 0.1

    def loss(tree):
        total, mean = share(*tree)
        return jnp.sum(total * jnp.sin(mean))

    tree = (xy, disparity, weight, surface, jnp.asarray(_TOLERANCE))
    check_modes(loss, tree, rtol=1e-5, key=jax.random.key(0))
