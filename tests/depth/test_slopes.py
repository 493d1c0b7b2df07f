"""Slopes: what neighboring pixels should differ by."""

import jax
import jax.numpy as jnp
import numpy as np
from helpers import check_gradient

from mvedge_jax.depth._slopes import Slopes, rises, slope_labels
from mvedge_jax.diffusion import AutoSolver, System, diffuse


def asked(disparity, weight, edges, *, params=None, tolerance=1e-3):
    """The rises that follow from a map, as the chain solves for them."""
    params = Slopes() if params is None else params
    along = [params.stiffness * t for t in edges]
    solver = AutoSolver(tolerance=jnp.asarray(tolerance))
    found = [
        diffuse(System(held, label, *along), solver=solver).value
        for held, label in zip(*slope_labels(disparity, weight, edges, params), strict=True)
    ]
    return rises(jnp.stack(found))


def slanted_wall():
    """A plane known at both ends alone, and the smoothness of an image without outlines."""
    y, x = np.mgrid[0:24, 0:40]
    plane = jnp.asarray(0.02 * x - 0.01 * y)
    weight = jnp.full(plane.shape, 1e-4).at[:, :8].set(1.0).at[:, -8:].set(1.0)
    return plane, weight, (jnp.ones((24, 39)), jnp.ones((23, 40)))


def test_slopes_of_a_plane_are_its_own():
    plane, weight, edges = slanted_wall()
    along_x, along_y = asked(plane, weight, edges)
    np.testing.assert_allclose(along_x, 0.02, rtol=0.01)
    np.testing.assert_allclose(along_y, -0.01, rtol=0.01)


def test_a_wall_that_little_is_known_of_stays_slanted():
    # Labels on the left half alone: a membrane goes on flat, with slopes it goes on.
    plane, _, edges = slanted_wall()
    weight = jnp.full(plane.shape, 1e-6).at[:, :20].set(1.0)
    tight = AutoSolver(tolerance=1e-8)
    flat = diffuse(System(weight, jnp.where(weight > 0.5, plane, 0), *edges), solver=tight).value
    slopes = asked(flat, weight, edges)
    labels = jnp.where(weight > 0.5, plane, flat)
    slanted = diffuse(System(weight, labels, *edges, *slopes), solver=tight).value
    before, after = (float(jnp.abs(d - plane)[:, 30:].mean()) for d in (flat, slanted))
    assert after < 0.2 * before


def test_a_cut_edge_is_no_slope():
    step = jnp.tile(jnp.where(jnp.arange(30) < 15, 0.0, 0.2), (20, 1))
    edges = jnp.ones((20, 29)).at[:, 14].set(1e-6), jnp.ones((19, 30))
    along_x, along_y = asked(step, jnp.ones((20, 30)), edges)
    assert float(jnp.abs(along_x).max()) < 1e-4
    assert float(jnp.abs(along_y).max()) < 1e-4


def test_gradient_matches_differences():
    keys = jax.random.split(jax.random.key(0), 4)
    disparity = 0.1 * jax.random.normal(keys[0], (7, 8))
    weight = jax.random.uniform(keys[1], (7, 8)) + 0.1
    tx, ty = (
        jax.random.uniform(k, s) + 0.1 for k, s in zip(keys[2:], ((7, 7), (6, 8)), strict=True)
    )

    def loss(tree):
        disparity, weight, tx, ty, params = tree
        along_x, along_y = asked(disparity, weight, (tx, ty), params=params, tolerance=1e-12)
        return jnp.sum(along_x**2) + jnp.sum((along_y - 0.1) ** 2)

    tree = disparity, weight, tx, ty, Slopes()
    check_gradient(loss, tree, rtol=1e-5, step=1e-6, key=keys[0])
