"""The two passes of Eq. 4.8 to 4.11 as printed (norms squared), against a dense system in loops."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from edges.test_occlusion import make_points

from mvedge_jax.diffusion import AutoSolver
from mvedge_jax.edges.sides import ThesisSides, bidirectional

SHAPE = (9, 11)
EPSILON = 1e-4


def _gradient(image):
    """Central differences, borders repeated."""
    wide = np.pad(image, 1, mode="edge")
    across, down = wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]
    return np.hypot(across, down) / 2


def _solved(weight, label, smoothness):
    """The map of least energy: every edge of the grid once, with the lesser of its two weights."""
    pixels = np.arange(weight.size).reshape(weight.shape)
    matrix = np.diag(weight.ravel())
    for a, b in (
        *zip(pixels[:, :-1].ravel(), pixels[:, 1:].ravel(), strict=True),
        *zip(pixels[:-1].ravel(), pixels[1:].ravel(), strict=True),
    ):
        edge = np.zeros(weight.size)
        edge[[a, b]] = 1, -1
        matrix += min(smoothness.flat[a], smoothness.flat[b]) * np.outer(edge, edge)
    return np.linalg.solve(matrix, (weight * label).ravel()).reshape(weight.shape)


def test_both_passes_minimise_the_printed_energy():
    rng = np.random.default_rng(3)
    gray = np.where(np.arange(SHAPE[1]) < 5, 0.2, 0.8) + 0.02 * rng.random(SHAPE)
    count = 14
    xy = rng.uniform(-0.4, np.array(SHAPE[::-1]) - 0.6, (count, 2))
    disparity, angle = rng.normal(size=count), rng.uniform(0, 2 * np.pi, count)
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    diffusion = ThesisSides.printed().diffusion
    diffusion = eqx.tree_at(lambda d: d.solver, diffusion, AutoSolver(tolerance=1e-9))
    assert diffusion.form == "inverse"
    found = bidirectional(make_points(xy, disparity, normal), jnp.asarray(gray), diffusion)
    smoothness = 1 / (_gradient(gray) + EPSILON)
    for sign, passed in ((1, found.forward), (-1, found.backward)):
        weight, label = np.zeros(SHAPE), np.full(SHAPE, -np.inf)
        for place, value in zip(xy + sign * normal, disparity, strict=True):
            x, y = np.floor(place + 0.5).astype(int)
            if 0 <= x < SHAPE[1] and 0 <= y < SHAPE[0]:
                # Of several labels on one pixel, the nearest surface stays.
                weight[y, x], label[y, x] = 1e6, max(label[y, x], value)
        expected = _solved(weight, np.where(weight > 0, label, 0), smoothness)
        np.testing.assert_allclose(passed, expected, atol=1e-6)
