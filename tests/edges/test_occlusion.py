"""Surface vectors, depth-edge confidence, and what they are made from."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces
from numpy.testing import assert_allclose, assert_array_equal

from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import EdgePoints, rasterise
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
from mvedge_jax.edges.sides._surface import along_edge, choose
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


def test_rasterise_keeps_the_nearest_surface_and_drops_what_is_outside():
    xy = [(1.2, 2.4), (0.8, 1.6), (5.0, 1.0), (-3.0, 0.0), (2.0, 0.0)]
    points = make_points(xy, [0.5, 0.9, -1.0, 3.0, 7.0], [(1, 0)] * 5, [True] * 4 + [False])
    raster = rasterise(points.xy, points.disparity, points.valid, (4, 6))
    expected = np.zeros((4, 6))
    expected[2, 1], expected[1, 5] = 0.9, -1.0
    assert_array_equal(raster.values(points.disparity), expected)
    assert int(raster.hit.sum()) == 2


def test_masked_points_change_neither_labels_nor_gradients():
    def total(disparity, valid):
        raster = rasterise(jnp.array([[1.0, 1.0], [2.0, 1.0]]), disparity, valid, (3, 4))
        return jnp.sum(raster.values(disparity) ** 2)

    gradient = jax.grad(total)(jnp.array([2.0, jnp.inf]), jnp.array([True, False]))
    assert_allclose(gradient, [4.0, 0.0])


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


def test_probabilities_approach_a_choice_and_have_a_gradient():
    score = jnp.linspace(-0.3, 0.3, POINTS.disparity.shape[0])
    cold, warm = (SideVote(temperature=jnp.asarray(t)) for t in (1e-4, 0.1))
    assert_allclose(choose(POINTS, score, cold).forward, score > 0, atol=1e-6)
    gradient = jax.grad(lambda s: choose(POINTS, s, warm).forward.sum())(score)
    assert float(jnp.abs(gradient).min()) > 0


def test_along_edge_outvotes_a_lone_dissenter():
    sign = POINTS.normal[:, 0]
    score = sign.at[50].multiply(-1.0)
    assert AT_EDGE[50]
    smoothed = along_edge(POINTS, score, shape=SHAPE, reach=6)
    assert_array_equal(jnp.sign(smoothed), sign)
    assert_array_equal(along_edge(POINTS, score, shape=SHAPE, reach=0), score)


def test_invalid_slots_take_no_part(passes):
    normals = [(0.0, 1.0), (1.0, 0.0)]
    junk = make_points([(14.0, 5.0), (15.0, 9.0)], [9.0, -9.0], normals, [False, False])
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), POINTS, junk)
    more = bidirectional(both, GRAY, DirectionalDiffusion())
    assert_array_equal(passes.forward, more.forward)
    assert_array_equal(more.response[-2:], 0)
    one, two = (
        surface_vectors(p, b.response, None, SideVote(), shape=SHAPE)
        for p, b in ((POINTS, passes), (both, more))
    )
    assert_array_equal(one.offset, two.offset[:-2])
    assert_array_equal(two.offset[-2:], 0)


def test_no_points_at_all_is_a_flat_map():
    nothing = eqx.tree_at(lambda p: p.valid, POINTS, jnp.zeros_like(POINTS.valid))
    found = bidirectional(nothing, jnp.full(SHAPE, 0.5), DirectionalDiffusion())
    for image in (found.forward, found.backward, found.edge, found.response):
        assert_array_equal(image, 0)


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


def test_one_trace_serves_every_parameter():
    run, traces = count_traces(lambda p: bidirectional(POINTS, GRAY, p).response)
    first = run(DirectionalDiffusion())
    second = run(DirectionalDiffusion(data=jnp.asarray(3.0), gradient=jnp.asarray(1e-2)))
    assert traces() == 1
    assert float(jnp.abs(first - second).max()) > 0


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


def test_depth_edge_confidence_of_a_ramp_is_its_slope():
    ramp = jnp.broadcast_to(0.25 * jnp.arange(9.0), (5, 9))
    assert_allclose(depth_edge_confidence(ramp, ramp)[:, 1:-1], 0.25)
    assert_array_equal(depth_edge_confidence(ramp, -ramp), 0)
    gradient = jax.grad(lambda d: depth_edge_confidence(d, d).sum())(jnp.zeros((4, 4)))
    assert bool(jnp.isfinite(gradient).all())


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


def test_both_passes_minimise_the_printed_energy():
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
