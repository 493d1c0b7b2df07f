"""Derivatives: those of a dense solve, and differences where its matrix is singular."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import dense, member, positive_system, random_system, stacked
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


def _by_elimination(system):
    return diffuse(system, solver=Elimination(tolerance=1e-13)).value


def _by_multigrid(system):
    return diffuse(system, solver=Multigrid(tolerance=1e-13)).value


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

    def turned(name):
        """The gradient in one field moves; the others are constants, without a tangent."""

        def of(values):
            return loss(eqx.tree_at(lambda s: getattr(s, name), system, values))

        return jax.jvp(jax.grad(of), (getattr(system, name),), (getattr(along, name),))[1]

    first = {
        "forward under vmap": jax.vmap(push)(directions)[1],
        "reverse": jax.grad(loss)(system),
    }
    second = {"forward over reverse": jax.jvp(jax.grad(loss), (system,), (along,))[1]}
    if every:
        first["reverse under vmap"] = jax.vmap(jax.grad(loss))(systems)
        second["reverse over forward"] = jax.grad(slope)(system)
        for name in ("weight", "label", "tx"):
            second[f"forward over reverse in {name}"] = turned(name)
    return first, second


@pytest.mark.parametrize(
    ("solve", "make", "every"),
    [
        (_by_elimination, _with_rises, True),
        (_by_multigrid, _with_gaps, False),
        (_by_lineax, _with_gaps, False),
    ],
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
            np.testing.assert_allclose(one, other, rtol=0, atol=rtol * size, err_msg=where)


@pytest.mark.parametrize(("shape", "kind"), [((40, 44), Multigrid), ((5, 24), Elimination)])
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


@pytest.mark.parametrize("shape", [(64, 64), (9, 64)])
@pytest.mark.parametrize("by_residual", [False, True])
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
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)
    assert float(jnp.abs(slope(coarse) - expected).max()) > 1e-6 * size


def test_statistics_have_no_gradient():
    system = random_system(*SHAPE, key=jax.random.key(9))
    gradient = jax.grad(lambda s: diffuse(s).stats.estimate)(system)
    assert all(float(jnp.abs(leaf).max()) == 0 for leaf in jax.tree.leaves(gradient))
    _, tangent = jax.jvp(lambda s: diffuse(s).stats.residual, (system,), (system,))
    assert float(tangent) == 0
