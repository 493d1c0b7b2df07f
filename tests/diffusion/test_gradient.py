"""Derivatives: those of a dense solve, and differences where its matrix is singular."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import dense, direct, member, positive_system, random_system, stacked
from helpers import check_modes, lean, random_like
from numpy.testing import assert_allclose

from mvedge_jax.diffusion import (
    AutoSolver,
    Elimination,
    Multigrid,
    System,
    diffuse,
    linear_operator,
)

SHAPE = (9, 11)


def _by_elimination(system):
    return diffuse(system, solver=Elimination(tolerance=1e-13)).value


def _by_lineax(system):
    operator, right = linear_operator(system), system.right_hand_side()
    return lx.linear_solve(operator, right, Multigrid(tolerance=1e-13)).value


def _with_rises(key):
    system = positive_system(*SHAPE, key=key)
    keys = jax.random.split(key)
    rises = (jax.random.normal(k, t.shape) for k, t in zip(keys, system.edges, strict=True))
    return System(system.weight, system.label, *system.edges, *rises)


def _with_gaps(key):
    """Without rises, and with pixels that have no data."""
    return random_system(*SHAPE, contrast=1.0, key=key)


def _derivatives(solve, systems, directions, *, every):
    """What JAX composes of both modes, of the first and of the second order."""
    system, along = member(systems, 0), member(directions, 0)
    target = jax.random.normal(jax.random.key(2), SHAPE)

    def loss(system):
        return jnp.sum((solve(system) - target) ** 2)

    def push(direction):
        return jax.jvp(solve, (system,), (direction,))

    def slope(system):
        return jax.jvp(loss, (system,), (along,))[1]

    def of_weight(weight):
        """The other fields are constants, without a tangent."""
        return loss(eqx.tree_at(lambda s: s.weight, system, weight))

    first = {"forward under vmap": jax.vmap(push)(directions)[1], "reverse": jax.grad(loss)(system)}
    second = {"forward over reverse": jax.jvp(jax.grad(loss), (system,), (along,))[1]}
    if every:
        first["reverse under vmap"] = jax.vmap(jax.grad(loss))(systems)
        second["reverse over forward"] = jax.grad(slope)(system)
        second["forward over reverse in the weight alone"] = jax.jvp(
            jax.grad(of_weight), (system.weight,), (along.weight,)
        )[1]
    return first, second


@pytest.mark.parametrize(
    ("solve", "make", "every"),
    [(_by_elimination, _with_rises, True), (_by_lineax, _with_gaps, False)],
)
def test_derivatives_are_those_of_a_dense_solve(solve, make, every):
    systems = stacked([make(jax.random.key(k)) for k in (4, 5)])
    directions = stacked([random_like(member(systems, 0), key=jax.random.key(k)) for k in (6, 7)])
    found, expected = (
        lean(lambda *trees, solve=solve: _derivatives(solve, *trees, every=every))(
            systems, directions
        )
        for solve in (solve, dense)
    )
    for order, rtol in enumerate((1e-9, 1e-8)):
        for (path, one), other in zip(
            jax.tree_util.tree_leaves_with_path(found[order]),
            jax.tree.leaves(expected[order]),
            strict=True,
        ):
            size = float(jnp.abs(other).max())
            assert size > 0
            where = jax.tree_util.keystr(path)
            assert_allclose(one, other, rtol=0, atol=rtol * size, err_msg=where)


@pytest.mark.parametrize(
    ("shape", "kind"),
    [pytest.param((40, 44), Multigrid, marks=pytest.mark.slow), ((5, 24), Elimination)],
)
def test_both_modes_beside_pixels_that_nothing_ties_to_data(shape, kind):
    system = positive_system(*shape, key=jax.random.key(11))
    weight, tx, ty = (a.at[1:4, 1:4].set(0) for a in (system.weight, *system.edges))
    system = System(weight, system.label, tx.at[1:4, 0].set(0), ty.at[0, 1:4].set(0))
    target = jax.random.normal(jax.random.key(12), shape)

    def loss(tree):
        # A tie to the rest would make the map jump.
        tied = jax.tree.map(lambda a, b: jnp.where(b != 0, a, 0), tree, system)
        return jnp.sum(jnp.sin(diffuse(tied, solver=kind(tolerance=1e-13)).value - target) ** 2)

    check_modes(loss, system, rtol=1e-6, step=1e-5, key=jax.random.key(13))


@pytest.mark.parametrize(("shape", "by_residual"), [((33, 34), False), ((9, 64), True)])
def test_a_loss_of_any_size_has_its_gradient(shape, by_residual):
    """In float32, the precision that ships."""
    system = random_system(*shape, contrast=1.0, dtype=jnp.float32, key=jax.random.key(20))
    target = jax.random.normal(jax.random.key(21), shape, jnp.float32)

    @lean
    def gradient(scale):
        def loss(system):
            difference = diffuse(system, solver=AutoSolver(by_residual=by_residual)).value - target
            return scale * jnp.mean(difference * difference)

        return jax.tree.leaves(jax.grad(loss)(system))

    expected = gradient(jnp.float32(1))
    for power in (-30, -20, -18, -10, 10, 18, 20, 30):
        scale = jnp.float32(10.0**power)
        for a, b in zip(gradient(scale), expected, strict=True):
            found = np.asarray(a, np.float64) / np.float64(scale)
            error = np.abs(found - np.asarray(b, np.float64)).max()
            assert error <= 1e-5 * float(jnp.abs(b).max()), f"1e{power}: {error:.2e}"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_cotangent_that_is_not_finite_does_not_pass_for_zero(value):
    system = random_system(20, 20, key=jax.random.key(22))
    factor = jnp.ones(system.shape).at[3, 3].set(value)
    gradient = jax.grad(lambda s: jnp.sum(factor * diffuse(s).value))(system)
    assert bool(jnp.isnan(gradient.label).any())


@pytest.mark.parametrize("adjoint", [AutoSolver(tolerance=1e-13), lx.CG(1e-13, 1e-13)], ids=type)
def test_the_adjoint_may_be_another_solver(adjoint):
    """The solve itself is so coarse that its own solver would not do for the derivatives."""
    system = positive_system(*SHAPE, key=jax.random.key(25))
    cotangent = jax.random.normal(jax.random.key(26), SHAPE)

    def slope(solve):
        def loss(label):
            return jnp.vdot(solve(eqx.tree_at(lambda s: s.label, system, label)), cotangent)

        return jax.grad(loss)(system.label)

    def coarse(system, adjoint=None):
        return diffuse(system, solver=Multigrid(tolerance=0.3), adjoint=adjoint).value

    expected = slope(dense)
    size = float(jnp.abs(expected).max())
    found = slope(lambda s: coarse(s, adjoint))
    assert_allclose(found, expected, rtol=0, atol=1e-9 * size)
    assert float(jnp.abs(slope(coarse) - expected).max()) > 1e-6 * size


RIGHT = jax.random.normal(jax.random.key(1), SHAPE)


@pytest.mark.parametrize("kind", [AutoSolver, Multigrid, Elimination])
def test_equals_the_direct_solve_and_diffuse(kind):
    system = random_system(*SHAPE, key=jax.random.key(0))
    operator, right = linear_operator(system), system.right_hand_side()
    found = lean(lambda o, r: lx.linear_solve(o, r, kind(tolerance=1e-13)).value)(operator, right)
    assert_allclose(found, direct(system), rtol=0, atol=1e-10)
    diffused = diffuse(system, solver=kind(tolerance=1e-13)).value
    assert_allclose(found, diffused, rtol=0, atol=1e-10)


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
        assert_allclose(found.value, expected, rtol=0, atol=1e-9 * size)
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
    assert_allclose(found.value, direct(system), rtol=0, atol=1e-9)
    few = diffuse(system, solver=lx.CG(1e-12, 1e-12, max_steps=3))
    assert not bool(few.stats.converged)


def test_the_operator_as_lineax_sees_it():
    system = random_system(4, 5, key=jax.random.key(7))
    operator, matrix = linear_operator(system), system.to_scipy().toarray()
    for seen in (operator, lx.materialise(operator), lx.conj(operator.T)):
        assert_allclose(seen.as_matrix(), matrix, rtol=1e-12, atol=1e-12)
    assert_allclose(lx.diagonal(operator), np.diag(matrix), rtol=1e-14)
    assert lx.is_symmetric(operator)
    assert lx.is_positive_semidefinite(operator)
    assert not lx.is_diagonal(operator)
