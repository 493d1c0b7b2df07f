"""Our solvers in `lineax.linear_solve`, under every composition of transforms."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import direct, random_system
from helpers import check_modes, lean, random_like

from mvedge_jax.diffusion import (
    AutoSolver,
    Elimination,
    Multigrid,
    System,
    diffuse,
    linear_operator,
)

SHAPE = (9, 11)


def solved(system, right, kind=Multigrid):
    return lx.linear_solve(linear_operator(system), right, kind(tolerance=1e-13)).value


def dense(system, right):
    matrix = linear_operator(system).as_matrix()
    return jnp.linalg.solve(matrix, right.ravel()).reshape(right.shape)


def positive_system(seed):
    """Away from zero weights, where a step would make the matrix indefinite."""
    system = random_system(*SHAPE, contrast=1.0, key=jax.random.key(seed))
    return jax.tree.map(lambda maps: maps + 0.1, system)


def close(found, expected, rtol=1e-9):
    for a, b in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * float(jnp.abs(b).max()))


@pytest.mark.parametrize("kind", [AutoSolver, Multigrid, Elimination])
def test_equals_the_direct_solve_and_diffuse(kind):
    system = random_system(*SHAPE, key=jax.random.key(0))
    solve = lean(lambda s: solved(s, s.right_hand_side(), kind))
    np.testing.assert_allclose(solve(system), direct(system), rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        solve(system), diffuse(system, solver=kind(1e-13)).value, rtol=0, atol=1e-10
    )


def _loss(solve):
    return lambda system, right: jnp.sum(jnp.sin(solve(system, right)))


RIGHT = jax.random.normal(jax.random.key(1), SHAPE)
COMPOSITIONS = {
    "grad": lambda f: jax.grad(_loss(f), (0, 1))(positive_system(2), RIGHT),
    "jvp": lambda f: jax.jvp(f, (positive_system(2), RIGHT), (positive_system(3), 2 * RIGHT))[1],
    "vmap of right-hand sides": lambda f: jax.vmap(lambda right: f(positive_system(2), right))(
        jnp.stack([RIGHT, RIGHT**2])
    ),
    "vmap of grad": lambda f: jax.vmap(lambda s: jax.grad(_loss(f))(s, RIGHT))(
        jax.tree.map(lambda *maps: jnp.stack(maps), positive_system(2), positive_system(3))
    ),
    "jvp of grad": lambda f: jax.jvp(
        lambda right: jax.grad(_loss(f))(positive_system(2), right), (RIGHT,), (RIGHT**2,)
    )[1],
}


@pytest.mark.parametrize("name", COMPOSITIONS)
def test_compositions(name):
    run = COMPOSITIONS[name]
    close(lean(lambda: run(solved))(), lean(lambda: run(dense))())


def test_derivatives_equal_differences():
    system = positive_system(4)
    check_modes(lambda s: _loss(solved)(s, RIGHT), system, rtol=1e-5, key=jax.random.key(5))


def test_a_state_serves_many_right_hand_sides():
    system = positive_system(6)
    operator, solver = linear_operator(system), Multigrid(tolerance=1e-12)
    state = solver.init(operator, {})
    for right in (RIGHT, random_like(RIGHT, key=jax.random.key(7))):
        found = lx.linear_solve(operator, right, solver, state=state)
        close(found.value, dense(system, right))


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
    system: System = random_system(*SHAPE, contrast=0.5, key=jax.random.key(9))
    found = diffuse(system, solver=lx.CG(1e-12, 1e-12))
    assert bool(found.stats.converged)
    np.testing.assert_allclose(found.value, direct(system), rtol=0, atol=1e-9)
    few = diffuse(system, solver=lx.CG(1e-12, 1e-12, max_steps=3))
    assert not bool(few.stats.converged)
