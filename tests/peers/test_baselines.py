"""Baselines: k-means and the thesis' superpixels against loops, solvers against direct solves."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffusion.problems import direct, random_system
from numpy.testing import assert_allclose, assert_array_equal

from experiments.peers._lfsp_painting import Ends, painted
from experiments.peers.kmeans import KMeansParams, KMeansSizes, kmeans_superpixels
from experiments.peers.lfsp import LfspParams, LfspSizes, thesis_superpixels
from experiments.peers.solvers import HierarchicalBasis, Jacobi
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.diffusion import diffuse
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics.superpixels import superpixel_scores


def _scene(shape=(1, 3, 14, 18)):
    rng = np.random.default_rng(0)
    views = jnp.asarray(rng.random((*shape, 3)))
    x = np.arange(shape[3])
    disparity = np.broadcast_to(np.where(abs(x - 9) < 4, 2.0, 0.0), shape[2:])
    return LightField(views), jnp.asarray(disparity)


def _loops(lab, disparity, size, rounds):
    """Labels of the center view, written as the definition."""
    height, width = disparity.shape
    z = (disparity - disparity.min()) / np.ptp(disparity)
    pixels = [(np.array([x, y]), z[y, x], lab[y, x]) for y in range(height) for x in range(width)]
    centers = [
        pixels[y * width + x]
        for y in range(size // 2, height // size * size, size)
        for x in range(size // 2, width // size * size, size)
    ]

    def cost(p, c):
        away, color = np.linalg.norm(p[0] - c[0]), np.linalg.norm(p[2] - c[2])
        return away + 120 * abs(p[1] - c[1]) + 2 * color

    labels: list[int] = []
    for k in range(rounds):
        labels = [int(np.argmin([cost(p, c) for c in centers])) for p in pixels]
        if k < rounds - 1:
            groups = [[p for p, j in zip(pixels, labels, strict=True) if j == i]
                      for i in range(len(centers))]  # fmt: skip
            centers = [tuple(np.mean([p[n] for p in g], axis=0) for n in range(3)) for g in groups]
    return 1 + np.array(labels).reshape(height, width)


def test_clusters_are_those_of_loops_and_labels_move_with_their_disparity():
    field, disparity = _scene()
    sizes = KMeansSizes(size=6, rounds=3)
    found = np.asarray(kmeans_superpixels(field, disparity, KMeansParams(), sizes))
    lab, center = np.asarray(srgb_to_lab(field.center_view)), found[0, 1]
    assert_array_equal(center, _loops(lab, np.asarray(disparity), 6, 3))
    assert_array_equal(found[0, 0][:, 8:15], center[:, 6:13])
    assert_array_equal(found[0, 2][:, 4:11], center[:, 6:13])
    assert (found > 0).all()  # holes are filled


@pytest.mark.parametrize("kind", [HierarchicalBasis, Jacobi])
@pytest.mark.parametrize("shape", [(9, 14), pytest.param((35, 3), marks=pytest.mark.slow)])
def test_solutions_are_direct_and_the_preconditioner_symmetric_and_definite(kind, shape):
    system = random_system(*shape, key=jax.random.key(2))
    found = diffuse(system, solver=kind(tolerance=1e-11))
    assert bool(found.stats.converged)
    assert_allclose(found.value, direct(system), rtol=0, atol=1e-9)
    precondition = kind().preconditioner(kind().prepare(system.coefficients))
    images = jnp.eye(shape[0] * shape[1]).reshape(-1, *shape)
    matrix = np.asarray(jax.jit(jax.vmap(lambda image: precondition(image).ravel()))(images)).T
    assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0


def _plane(slope, shape=(3, 3, 30, 40)):
    """A textured plane of one disparity, and a card before it at another."""
    rng = np.random.default_rng(0)
    far, near = np.repeat(np.repeat(rng.random((2, 20, 20, 3)), 4, 1), 4, 2)
    y, x = np.mgrid[: shape[2], : shape[3]]
    views, disparity = np.zeros((*shape, 3)), np.zeros(shape)
    for v, u in np.ndindex(shape[:2]):
        a, b = shape[1] // 2 - u, shape[0] // 2 - v
        on = (abs(y - b * slope - 15) < 8) & (abs(x - a * slope - 20) < 9)
        moved = near[(y - b * slope + 20) % 80, (x - a * slope + 20) % 80]
        views[v, u] = np.where(on[..., None], 0.3 * moved + [0.6, 0.1, 0], 0.5 * far[y, x])
        disparity[v, u] = np.where(on, slope, 0)
    return LightField(jnp.asarray(views, jnp.float32)), jnp.asarray(disparity, jnp.float32)


def _found(field, **choices):
    default = LfspParams()
    params = eqx.tree_at(lambda p: p.lines, default, replace(default.lines, capacity=48))
    return thesis_superpixels(field, params, LfspSizes(size=10, **choices))


@pytest.mark.parametrize("slope", [1, pytest.param(-1, marks=pytest.mark.slow)])
def test_labels_keep_to_surfaces_in_all_views(slope):
    field, disparity = _plane(slope)
    labels = _found(field)
    ids = (disparity != 0).astype(jnp.int32)
    scores = superpixel_scores(labels, ids, disparity)
    assert float(scores.accuracy) > 0.9
    assert float(scores.unlabeled) == 0
    assert float(scores.inconsistent) < 0.06


@pytest.mark.parametrize("steps", [(0, 0), (1, 0), (-2, 1)])
def test_segments_are_drawn_nearest_on_top_where_views_show_them(steps):
    epi = np.array([2.0, 2.0, 3.0])
    left = np.array([[1.0, 0.0], [4.5, 1.0], [2.0, -1.0]])
    right = np.array([[9.0, 0.0], [7.0, 1.0], [3.0, -1.0]])
    ends, disparity = Ends.of(epi, left, right), jnp.asarray(left[:, 1])
    drawn = painted(ends, disparity, jnp.asarray(steps, float), shape=(8, 12), width=16)
    wanted = np.full((8, 12), -1)
    for k in (2, 0, 1):
        row = int(epi[k] + steps[1] * left[k, 1])
        first, last = (line[k, 0] + steps[0] * line[k, 1] for line in (left, right))
        columns = np.arange(12)
        wanted[row, (columns >= first) & (columns < last)] = k
    assert_array_equal(drawn, wanted)
