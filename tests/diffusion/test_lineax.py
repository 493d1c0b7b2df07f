"""Our solvers in `lineax.linear_solve`, the matrix as Lineax sees it, and solvers of Lineax."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import dense, direct, positive_system, random_system
from helpers import lean, random_like

from mvedge_jax.diffusion import AutoSolver, Elimination, Multigrid, diffuse, linear_operator

SHAPE = (9, 11)
RIGHT = jax.random.normal(jax.random.key(1), SHAPE)


@pytest.mark.parametrize("kind", [AutoSolver, Multigrid, Elimination])
def test_equals_the_direct_solve_and_diffuse(kind):
    system = random_system(*SHAPE, key=jax.random.key(0))
    operator, right = linear_operator(system), system.right_hand_side()
    found = lean(lambda o, r: lx.linear_solve(o, r, kind(tolerance=1e-13)).value)(operator, right)
    np.testing.assert_allclose(found, direct(system), rtol=0, atol=1e-10)
    diffused = diffuse(system, solver=kind(tolerance=1e-13)).value
    np.testing.assert_allclose(found, diffused, rtol=0, atol=1e-10)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("kind", [Multigrid, Elimination])
def test_a_state_serves_right_hand_sides_of_any_size(kind, scale):
    system = positive_system(*SHAPE, key=jax.random.key(6))
    operator, solver = linear_operator(system), kind(tolerance=1e-12)
    state = solver.init(operator, {})
    for right in (RIGHT, random_like(RIGHT, key=jax.random.key(7))):
        found = lx.linear_solve(operator, scale * right, solver, state=state)
        expected = dense(system, scale * right)
        size = float(jnp.abs(expected).max())
        np.testing.assert_allclose(found.value, expected, rtol=0, atol=1e-9 * size)
        assert float(found.stats["estimate"]) < 2e-12 * size


def test_failures_are_results():
    system = random_system(*SHAPE, key=jax.random.key(8))
    operator = linear_operator(system)
    few = lx.linear_solve(
        operator, RIGHT, Multigrid(tolerance=1e-12, max_iterations=2), throw=False
    )
    assert few.result == lx.RESULTS.max_steps_reached
    nothing = eqx.tree_at(lambda s: s.weight, system, jnp.zeros(SHAPE))
    singular = lx.linear_solve(linear_operator(nothing), RIGHT, Multigrid(), throw=False)
    assert singular.result == lx.RESULTS.singular
    with pytest.raises(TypeError, match="`Multigrid` solves what `linear_operator"):
        lx.linear_solve(lx.IdentityLinearOperator(operator.in_structure()) * 2, RIGHT, Multigrid())


def test_diffuse_takes_solvers_of_lineax():
    system = random_system(*SHAPE, contrast=0.5, key=jax.random.key(9))
    found = diffuse(system, solver=lx.CG(1e-12, 1e-12))
    assert bool(found.stats.converged)
    np.testing.assert_allclose(found.value, direct(system), rtol=0, atol=1e-9)
    few = diffuse(system, solver=lx.CG(1e-12, 1e-12, max_steps=3))
    assert not bool(few.stats.converged)


def test_the_operator_as_lineax_sees_it():
    system = random_system(4, 5, key=jax.random.key(7))
    operator, matrix = linear_operator(system), system.to_scipy().toarray()
    for seen in (operator, lx.materialise(operator), lx.conj(operator.T)):
        np.testing.assert_allclose(seen.as_matrix(), matrix, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(lx.diagonal(operator), np.diag(matrix), rtol=1e-14)
    assert lx.is_symmetric(operator)
    assert lx.is_positive_semidefinite(operator)
    assert not lx.is_diagonal(operator)
