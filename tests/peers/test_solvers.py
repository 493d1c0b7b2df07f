"""The thesis' solver and the plainest one: the same solutions, symmetric preconditioners."""

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import direct, random_system

from experiments.peers.solvers import HierarchicalBasis, Jacobi
from mvedge_jax.diffusion import Multigrid, System, diffuse, linear_operator

KINDS = pytest.mark.parametrize("kind", [HierarchicalBasis, Jacobi])


@KINDS
def test_solutions_are_those_of_a_direct_solve(kind):
    system = random_system(23, 31, key=jax.random.key(1))
    found = diffuse(system, solver=kind(tolerance=1e-11))
    assert bool(found.stats.converged)
    np.testing.assert_allclose(found.value, direct(system), rtol=0, atol=1e-9)


@KINDS
@pytest.mark.parametrize("shape", [(9, 14), (35, 3)])
def test_preconditioner_is_symmetric_and_definite(kind, shape):
    system = random_system(*shape, key=jax.random.key(2))
    solver = kind()
    precondition = solver.preconditioner(solver.prepare(system.coefficients))
    images = jnp.eye(shape[0] * shape[1]).reshape(-1, *shape)
    matrix = np.asarray(jax.jit(jax.vmap(lambda image: precondition(image).ravel()))(images)).T
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    assert np.linalg.eigvalsh(matrix).min() > 0


@KINDS
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_lineax_says_how_an_adjoint_solve_went(kind, scale):
    system = random_system(12, 15, contrast=1.0, key=jax.random.key(23))
    cotangent = scale * jax.random.normal(jax.random.key(24), system.shape)
    found = lx.linear_solve(linear_operator(system), cotangent, kind(tolerance=1e-10))
    rest = cotangent - system.matvec(found.value)
    assert float(jnp.linalg.norm(rest)) < 1e-8 * float(jnp.linalg.norm(cotangent))
    assert float(found.stats["estimate"]) < 2e-10 * float(jnp.abs(found.value).max())


def test_either_may_solve_for_the_derivatives():
    system = random_system(9, 11, contrast=1.0, key=jax.random.key(25))
    cotangent = jax.random.normal(jax.random.key(26), system.shape)

    def slope(solver, adjoint):
        def loss(label):
            moved = System(system.weight, label, system.tx, system.ty)
            return jnp.vdot(diffuse(moved, solver=solver, adjoint=adjoint).value, cotangent)

        return jax.grad(loss)(system.label)

    tight = Multigrid(tolerance=1e-13)
    expected = slope(tight, tight)
    found = slope(Multigrid(tolerance=0.3), Jacobi(tolerance=1e-13))
    size = float(jnp.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)
