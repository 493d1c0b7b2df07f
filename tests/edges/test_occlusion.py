"""Surface vectors, depth-edge confidence, and what they are made from."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces

from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges import EdgePoints, rasterise
from mvedge_jax.edges.sides import (
    DirectionalDiffusion,
    SideVote,
    bidirectional,
    depth_edge_confidence,
    step_response,
    surface_vectors,
)
from mvedge_jax.edges.sides._evidence import map_evidence, neighbor_evidence
from mvedge_jax.edges.sides._profile import profiles
from mvedge_jax.edges.sides._surface import along_edge, choose
from mvedge_jax.photometry.measuring import visible_view_range

SHAPE = (24, 32)
EDGE = 16  # first column of the near surface in `square_wave`


def make_points(xy, disparity, normal, valid=None):
    count = len(disparity)
    xy = jnp.asarray(xy, float).reshape(count, 2)
    normal = jnp.asarray(normal, float).reshape(count, 2)
    return EdgePoints(
        xy=xy,
        disparity=jnp.asarray(disparity, float),
        confidence=jnp.full(count, 0.5),
        error=jnp.full(count, 0.005),
        normal=normal,
        visible=jnp.ones((count, 6), bool),
        valid=jnp.ones(count, bool) if valid is None else jnp.asarray(valid),
    )


def square_wave():
    """A near surface (d = 1) right of a depth edge over a far one (d = 0), with texture on both.

    The edge's own points carry the near disparity, their normals alternate in sign; texture lines
    at other columns carry the disparity of their own surface.
    """
    rows = np.arange(2, 22)
    xy, disparity, normal = [], [], []
    for column, d in ((4, 0.0), (9, 0.0), (EDGE - 0.4, 1.0), (22, 1.0), (28, 1.0)):
        for row in rows:
            xy.append((column, row))
            disparity.append(d)
            normal.append((1.0 if row % 2 else -1.0, 0.0))
    gray = np.full(SHAPE, 0.3)
    gray[:, EDGE:] = 0.7
    for column in (4, 9, 22, 28):
        gray[:, column:] += 0.05
    truth = np.where(np.arange(SHAPE[1]) < EDGE, 0.0, 1.0)
    return make_points(xy, disparity, normal), jnp.asarray(gray), truth


def at_the_edge(points):
    return np.abs(np.asarray(points.xy[:, 0]) - (EDGE - 0.4)) < 0.05


def test_rasterise_keeps_the_nearest_surface_and_drops_what_is_outside():
    points = make_points(
        [(1.2, 2.4), (0.8, 1.6), (5.0, 1.0), (-3.0, 0.0), (2.0, 0.0)],
        [0.5, 0.9, -1.0, 3.0, 7.0],
        [(1, 0)] * 5,
        [True, True, True, True, False],
    )
    raster = rasterise(points.xy, points.disparity, points.valid, (4, 6))
    label = np.asarray(raster.values(points.disparity))
    expected = np.zeros((4, 6))
    expected[2, 1], expected[1, 5] = 0.9, -1.0
    np.testing.assert_array_equal(label, expected)
    assert int(raster.hit.sum()) == 2


def test_masked_points_change_neither_labels_nor_gradients():
    def total(disparity, valid):
        raster = rasterise(jnp.array([[1.0, 1.0], [2.0, 1.0]]), disparity, valid, (3, 4))
        return jnp.sum(raster.values(disparity) ** 2)

    gradient = jax.grad(total)(jnp.array([2.0, jnp.inf]), jnp.array([True, False]))
    np.testing.assert_allclose(gradient, [4.0, 0.0])


@pytest.mark.parametrize("taps", [(-1.0, -1.5, -2.0, 2.0, 1.5, 1.0), (-1.0, -1.0, 1.0, 1.0)])
def test_step_response_is_twice_the_step_and_zero_when_flat(taps):
    before = jnp.array([0.0, 0, 0, 1, 1, 1, 1])[:, None] * 0.3
    after = jnp.array([0.0, 0, 0, 0, 1, 1, 1])[:, None] * -0.3
    flat = jnp.full((7, 1), 0.4)
    for profile, height in ((before, 0.6), (after, 0.6), (flat, 0.0)):
        assert float(step_response(profile, taps=taps)[0]) == pytest.approx(height, abs=1e-12)


def test_profiles_of_a_plane_are_linear_along_the_normal():
    y, x = jnp.mgrid[0:20, 0:30].astype(float)
    image = 0.1 * x - 0.2 * y
    normal = jnp.array([[0.6, 0.8]])
    found = profiles(image, jnp.array([[12.3, 9.1]]), normal)[:, 0]
    middle = 0.1 * 12.3 - 0.2 * 9.1
    expected = middle + np.arange(-3, 4) * (0.06 - 0.16)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_bidirectional_diffusion_finds_the_near_side_of_an_occlusion_edge():
    points, gray, truth = square_wave()
    passes = bidirectional(points, gray, DirectionalDiffusion())
    edge = at_the_edge(points)
    signs = np.sign(np.asarray(passes.response)) * np.asarray(points.normal[:, 0])
    # The near surface is on the right; the ends of the edge see it only from one side.
    assert (signs[edge] > 0).mean() >= 0.9
    # Both passes agree on the texture inside of a surface: little confidence there.
    confidence = np.asarray(passes.confidence)
    assert np.median(confidence[edge]) > 10 * np.median(confidence[~edge])
    profile = np.asarray(passes.edge)[8]
    assert abs(int(profile.argmax()) - (EDGE - 0.4)) <= 3
    assert profile.max() > 5 * np.median(profile)


def test_surface_vectors_move_labels_onto_their_surface():
    points, gray, truth = square_wave()
    passes = bidirectional(points, gray, DirectionalDiffusion())
    for response, dense in ((passes.response, None), (None, None), (None, truth)):
        dense = None if dense is None else jnp.broadcast_to(jnp.asarray(dense), SHAPE)
        surface = surface_vectors(points, response, dense, SideVote(), shape=SHAPE)
        edge = at_the_edge(points)
        np.testing.assert_allclose(np.asarray(surface.offset)[edge], [[1.0, 0.0]] * edge.sum())


def test_probabilities_approach_a_choice_and_have_a_gradient():
    points, _, _ = square_wave()
    score = jnp.linspace(-0.3, 0.3, points.disparity.shape[0])
    cold, warm = (SideVote(temperature=jnp.asarray(t)) for t in (1e-4, 0.1))
    np.testing.assert_allclose(choose(points, score, cold).forward, score > 0, atol=1e-6)
    gradient = jax.grad(lambda s: choose(points, s, warm).forward.sum())(score)
    assert float(jnp.abs(gradient).min()) > 0


def test_along_edge_outvotes_a_lone_dissenter():
    points, _, _ = square_wave()
    sign = points.normal[:, 0]
    score = sign.at[50].multiply(-1.0)
    assert at_the_edge(points)[50]
    smoothed = along_edge(points, score, shape=SHAPE, reach=6)
    assert (np.sign(np.asarray(smoothed)) == np.asarray(sign)).all()
    np.testing.assert_array_equal(along_edge(points, score, shape=SHAPE, reach=0), score)


def test_invalid_slots_take_no_part():
    points, gray, _ = square_wave()
    junk = make_points(
        [(14.0, 5.0), (15.0, 9.0)], [9.0, -9.0], [(0.0, 1.0), (1.0, 0.0)], [False, False]
    )
    both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), points, junk)
    alone, more = (bidirectional(p, gray, DirectionalDiffusion()) for p in (points, both))
    np.testing.assert_array_equal(alone.forward, more.forward)
    np.testing.assert_array_equal(more.response[-2:], 0)
    one, two = (
        surface_vectors(p, b.response, None, SideVote(), shape=SHAPE)
        for p, b in ((points, alone), (both, more))
    )
    np.testing.assert_array_equal(one.offset, two.offset[:-2])
    np.testing.assert_array_equal(two.offset[-2:], 0)


def test_no_points_at_all_is_a_flat_map():
    points = make_points([(0, 0)], [1.0], [(1, 0)], [False])
    passes = bidirectional(points, jnp.full((8, 9), 0.5), DirectionalDiffusion())
    for image in (passes.forward, passes.backward, passes.edge, passes.response):
        np.testing.assert_array_equal(image, 0)


def test_gradient_of_the_passes_matches_differences():
    points, gray, _ = square_wave()
    solver = AutoSolver(tolerance=jnp.asarray(1e-9))

    def loss(tree):
        disparity, logs = tree
        params = eqx.tree_at(lambda p: p.solver, jax.tree.map(jnp.exp, logs), solver)
        moved = make_points(points.xy, disparity, points.normal)
        passes = bidirectional(moved, gray, params)
        return jnp.sum(passes.confidence**2) + jnp.sum(passes.edge**2)

    spread = points.disparity + 0.01 * jnp.sin(jnp.arange(points.disparity.shape[0]))
    tree = (spread, jax.tree.map(jnp.log, DirectionalDiffusion()))
    check_gradient(loss, tree, rtol=1e-3, step=1e-6, key=jax.random.key(0))


def test_one_trace_serves_every_parameter():
    points, gray, _ = square_wave()
    run, traces = count_traces(lambda p: bidirectional(points, gray, p).response)
    first = run(DirectionalDiffusion())
    second = run(DirectionalDiffusion(data=jnp.asarray(3.0), gradient=jnp.asarray(1e-2)))
    assert traces() == 1
    assert float(jnp.abs(first - second).max()) > 0


def test_evidence_is_positive_towards_the_own_surface():
    points, _, truth = square_wave()
    raster = rasterise(points.xy, points.disparity, points.valid, SHAPE)
    edge = at_the_edge(points)
    towards = np.asarray(points.normal[:, 0])
    neighbours = neighbor_evidence(points, raster, radius=jnp.array(6.0), cap=jnp.array(0.3))
    dense = jnp.broadcast_to(jnp.asarray(truth), SHAPE)
    for evidence in (neighbours, map_evidence(points, dense, cap=jnp.array(0.3))):
        assert ((np.asarray(evidence) * towards)[edge] > 0.2).all()


def test_reach_agrees_with_brute_force():
    rng = np.random.default_rng(1)
    disparity = np.repeat(rng.uniform(-1, 1, (6, 8)), 4, axis=1)
    radius, least = 9, 0.05
    negative, positive = visible_view_range(jnp.asarray(disparity), radius=radius, step=least)
    expected = np.full((2, *disparity.shape), np.inf)
    for y, x in np.ndindex(disparity.shape):
        for j in range(1, radius + 1):
            for side, other in ((0, x + j), (1, x - j)):
                if 0 <= other < disparity.shape[1]:
                    rise = disparity[y, other] - disparity[y, x]
                    if rise > least:
                        expected[side, y, x] = min(expected[side, y, x], (j - 0.5) / rise)
    np.testing.assert_allclose(negative, expected[0])
    np.testing.assert_allclose(positive, expected[1])


def test_depth_edge_confidence_of_a_ramp_is_its_slope():
    ramp = jnp.broadcast_to(0.25 * jnp.arange(9.0), (5, 9))
    np.testing.assert_allclose(depth_edge_confidence(ramp, ramp)[:, 1:-1], 0.25)
    flat = depth_edge_confidence(ramp, -ramp)
    np.testing.assert_array_equal(flat, 0)
    gradient = jax.grad(lambda d: depth_edge_confidence(d, d).sum())(jnp.zeros((4, 4)))
    assert bool(jnp.isfinite(gradient).all())
