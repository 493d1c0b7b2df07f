"""The system as a matrix, edge weights, and the Lineax operator."""

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import direct, random_system
from helpers import check_gradient

from mvedge_jax.diffusion import System, diffuse, edge_weights, linear_operator


def test_matvec_diagonal_and_energy_agree_with_the_sparse_matrix():
    system = random_system(6, 9, key=jax.random.key(0))
    matrix = system.to_scipy().toarray()
    image = jax.random.normal(jax.random.key(1), system.shape)
    np.testing.assert_allclose(
        system.matvec(image).ravel(), matrix @ np.asarray(image).ravel(), rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(system.diagonal().ravel(), np.diag(matrix), rtol=1e-14)
    np.testing.assert_allclose(matrix, matrix.T)
    # Half of the gradient of the energy is what the normal equations set to zero.
    slope = jax.grad(system.energy)(image)
    expected = 2 * (system.matvec(image) - system.right_hand_side())
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-10)


def test_nothing_is_tied_to_the_border():
    system = random_system(6, 9, key=jax.random.key(2))
    constant = System(jnp.zeros((6, 9)), system.label, *system.edges)
    np.testing.assert_array_equal(constant.matvec(jnp.full((6, 9), 3.0)), 0)


def test_the_solution_minimises_the_energy():
    system = random_system(6, 9, key=jax.random.key(3))
    best = diffuse(system).value
    for i in range(3):
        step = 0.01 * jax.random.normal(jax.random.key(i), system.shape)
        assert float(system.energy(best + step)) > float(system.energy(best))


@pytest.mark.parametrize(
    ("pairing", "expected"),
    [("min", [1.0, 0.0]), ("mean", [2.0, 1.5]), ("harmonic", [1.5, 0.0]), ("second", [3.0, 0.0])],
)
def test_pairings(pairing, expected):
    tx, ty = edge_weights(jnp.array([[1.0, 3.0, 0.0]]), pairing=pairing)
    assert tx.tolist() == [expected]
    assert ty.shape == (0, 3)
    other = edge_weights(jnp.array([[1.0], [3.0], [0.0]]), pairing=pairing)[1]
    assert other[:, 0].tolist() == expected


def test_pairing_is_differentiable_and_checked():
    smoothness = jnp.exp(jax.random.normal(jax.random.key(4), (4, 5)))

    def total(smoothness):
        tx, ty = edge_weights(smoothness, pairing="harmonic")
        return jnp.sum(tx**2) + jnp.sum(ty**3)

    check_gradient(total, smoothness, rtol=1e-6, key=jax.random.key(5))
    with pytest.raises(ValueError, match="`pairing` must be"):
        edge_weights(smoothness, pairing="max")


def test_lineax_operator():
    system = random_system(6, 9, contrast=0.5, key=jax.random.key(6))
    operator = linear_operator(system)
    assert lx.is_symmetric(operator)
    assert lx.is_positive_semidefinite(operator)
    solution = lx.linear_solve(operator, system.right_hand_side(), lx.CG(1e-12, 1e-12))
    np.testing.assert_allclose(solution.value, direct(system), rtol=0, atol=1e-8)


def test_the_operator_as_lineax_sees_it():
    system = random_system(4, 5, key=jax.random.key(7))
    operator, matrix = linear_operator(system), system.to_scipy().toarray()
    for dense in (operator, lx.materialise(operator), lx.conj(operator.T)):
        np.testing.assert_allclose(dense.as_matrix(), matrix, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(lx.diagonal(operator), np.diag(matrix), rtol=1e-14)
    assert not lx.is_diagonal(operator)
