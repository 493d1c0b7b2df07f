"""The system as a matrix, and edge weights."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffusion.problems import random_system
from helpers import check_gradient

from mvedge_jax.diffusion import edge_weights


def test_matvec_diagonal_and_energy_agree_with_the_sparse_matrix():
    system = random_system(6, 9, key=jax.random.key(0))
    matrix = system.to_scipy().toarray()
    image = jax.random.normal(jax.random.key(1), system.shape)
    np.testing.assert_allclose(
        system.matvec(image).ravel(), matrix @ np.asarray(image).ravel(), rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(system.diagonal().ravel(), np.diag(matrix), rtol=1e-14)
    np.testing.assert_allclose(matrix, matrix.T)
    # Nothing is tied to the border.
    np.testing.assert_allclose(system.matvec(jnp.ones((6, 9))), system.weight, atol=1e-12)
    # Half of the gradient of the energy is what the normal equations set to zero.
    slope = jax.grad(system.energy)(image)
    expected = 2 * (system.matvec(image) - system.right_hand_side())
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-10)


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
