"""The preconditioner as a linear operator, and the coarse matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffusion.problems import random_system

from mvedge_jax.diffusion import Multigrid, System, diffuse
from mvedge_jax.diffusion._coarsen import Stencil, coarsen, interpolate, product, restrict


def dense(function, shape):
    size = shape[0] * shape[1]
    columns = jax.vmap(lambda image: function(image).ravel())(jnp.eye(size).reshape(size, *shape))
    return np.asarray(columns).T


def two_coarser(stencil):
    """Of the five-point stencil and of the nine-point one below it: coarse, Galerkin matrix."""
    for _ in range(2):
        coarse, weights = coarsen(stencil)
        shape, below = stencil.mass.shape, coarse.mass.shape
        up = dense(lambda image, w=weights, s=shape: interpolate(w, image, s), below)
        down = dense(lambda image, w=weights: restrict(w, image), shape)
        np.testing.assert_allclose(down, up.T, rtol=0, atol=1e-14)
        fine = dense(lambda image, s=stencil: product(s, image), shape)
        found = dense(lambda image, s=coarse: product(s, image), below)
        yield coarse, found, up.T @ fine @ up
        stencil = coarse


@pytest.mark.parametrize("shape", [(5, 6), (1, 7)])
def test_coarse_matrix_is_the_galerkin_product(shape):
    y, x = shape
    keys = jax.random.split(jax.random.key(0), 4)
    weight = jax.random.uniform(keys[0], shape)
    # Strong isolated data give negative row sums and strongly uneven edges negative ones, which
    # are cut off: not here.
    data = jnp.where(jax.random.bernoulli(keys[1], 0.4, shape), weight, 0)
    tx = jax.random.uniform(keys[2], (y, x - 1), minval=0.5)
    ty = jax.random.uniform(keys[3], (y - 1, x), minval=0.5)
    for _, found, galerkin in two_coarser(Stencil(data, tx, ty, None, None)):
        np.testing.assert_allclose(found, galerkin, rtol=0, atol=1e-12 * np.abs(galerkin).max())


def test_no_coarse_matrix_is_smaller_than_the_galerkin_product():
    """Edges of 1 and 1e-4 at random, where the product itself has negative ones."""
    keys = jax.random.split(jax.random.key(3), 3)
    tx = jnp.where(jax.random.bernoulli(keys[0], 0.5, (9, 9)), 1.0, 1e-4)
    ty = jnp.where(jax.random.bernoulli(keys[1], 0.5, (8, 10)), 1.0, 1e-4)
    weight = jnp.where(jax.random.bernoulli(keys[2], 0.1, (9, 10)), 1e5, 0.0)
    cut = []
    for coarse, found, galerkin in two_coarser(Stencil(weight, tx, ty, None, None)):
        cut.append(np.abs(found - galerkin).max())
        assert np.linalg.eigvalsh(found - galerkin).min() > -1e-9 * np.abs(found).max()
        assert all(float(maps.min()) >= 0 for maps in jax.tree.leaves(coarse))
    assert max(cut) > 1e-3


def test_interpolation_keeps_a_constant_where_there_is_no_data():
    system = random_system(6, 8, key=jax.random.key(1))
    _, weights = coarsen(Stencil(jnp.zeros((6, 8)), system.tx, system.ty, None, None))
    # The last column and row have a corner on one side only.
    np.testing.assert_allclose(interpolate(weights, jnp.ones((3, 4)), (6, 8)), 1, rtol=1e-14)


@pytest.mark.parametrize("shape", [(9, 14), (35, 3)])
def test_preconditioner_is_symmetric_and_definite(shape):
    system = random_system(*shape, key=jax.random.key(2))
    cycle = Multigrid().preconditioner(Multigrid().prepare(system.coefficients))
    matrix = dense(jax.jit(cycle), shape)
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0


@pytest.mark.slow
def test_iterations_hardly_grow_with_size():
    counts = []
    for size in (128, 1024):
        rows, columns = jnp.mgrid[:size, :size]
        weight = jnp.where((rows % 16 == 0) & (columns % 16 == 3), 1.0, 0.0)
        label = jnp.sin(9 * rows / size) + jnp.cos(7 * columns / size)
        maps = (weight, label, jnp.ones((size, size - 1)), jnp.ones((size - 1, size)))
        system = System(*(a.astype(jnp.float32) for a in maps))
        counts.append(int(diffuse(system, solver=Multigrid(by_residual=True)).stats.iterations))
    assert counts[1] <= 1.3 * counts[0]
