"""The thesis' solver and the plainest one: the same solutions, symmetric preconditioners."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffusion.problems import direct, random_system

from experiments.peers.solvers import HierarchicalBasis, Jacobi
from mvedge_jax.diffusion import diffuse


@pytest.mark.parametrize("kind", [HierarchicalBasis, Jacobi])
@pytest.mark.parametrize("shape", [(9, 14), pytest.param((35, 3), marks=pytest.mark.slow)])
def test_solutions_are_direct_and_the_preconditioner_symmetric_and_definite(kind, shape):
    system = random_system(*shape, key=jax.random.key(2))
    found = diffuse(system, solver=kind(tolerance=1e-11))
    assert bool(found.stats.converged)
    np.testing.assert_allclose(found.value, direct(system), rtol=0, atol=1e-9)
    precondition = kind().preconditioner(kind().prepare(system.coefficients))
    images = jnp.eye(shape[0] * shape[1]).reshape(-1, *shape)
    matrix = np.asarray(jax.jit(jax.vmap(lambda image: precondition(image).ravel()))(images)).T
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0
