"""The preconditioner as a linear operator, and the coarse matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffusion.problems import random_system
from helpers import check_gradient
from numpy.testing import assert_allclose

from mvedge_jax.diffusion import Multigrid, edge_weights
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
        assert_allclose(down, up.T, rtol=0, atol=1e-14)
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
        assert_allclose(found, galerkin, rtol=0, atol=1e-12 * np.abs(galerkin).max())


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


@pytest.mark.parametrize("shape", [(9, 14), (35, 3)])
def test_preconditioner_is_symmetric_and_definite(shape):
    system = random_system(*shape, key=jax.random.key(2))
    cycle = Multigrid().preconditioner(Multigrid().prepare(system.coefficients))
    matrix = dense(jax.jit(cycle), shape)
    assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0


def test_matvec_diagonal_and_energy_agree_with_the_sparse_matrix():
    system = random_system(6, 9, key=jax.random.key(0))
    matrix = system.to_scipy().toarray()
    image = jax.random.normal(jax.random.key(1), system.shape)
    assert_allclose(
        system.matvec(image).ravel(), matrix @ np.asarray(image).ravel(), rtol=0, atol=1e-10
    )
    assert_allclose(system.diagonal().ravel(), np.diag(matrix), rtol=1e-14)
    assert_allclose(matrix, matrix.T)
    # Nothing is tied to the border.
    assert_allclose(system.matvec(jnp.ones((6, 9))), system.weight, atol=1e-12)
    # Half of the gradient of the energy is what the normal equations set to zero.
    slope = jax.grad(system.energy)(image)
    expected = 2 * (system.matvec(image) - system.right_hand_side())
    assert_allclose(slope, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("pairing", "expected"),
    [("min", [1.0, 0.0]), ("mean", [2.0, 1.5]), ("harmonic", [1.5, 0.0]), ("second", [3.0, 0.0])],
)
def test_pairings(pairing, expected):
    row = jnp.array([[1.0, 3.0, 0.0]])
    tx, ty = edge_weights(row, pairing=pairing)
    assert tx.tolist() == [expected]
    assert ty.shape == (0, 3)
    assert edge_weights(row.T, pairing=pairing)[1][:, 0].tolist() == expected


def test_pairing_is_differentiable_and_checked():
    smoothness = jnp.exp(jax.random.normal(jax.random.key(4), (4, 5)))

    def total(smoothness):
        tx, ty = edge_weights(smoothness, pairing="harmonic")
        return jnp.sum(tx**2) + jnp.sum(ty**3)

    check_gradient(total, smoothness, rtol=1e-6, key=jax.random.key(5))
    with pytest.raises(ValueError, match="`pairing` must be"):
        edge_weights(smoothness, pairing="max")
