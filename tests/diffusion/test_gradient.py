"""Gradients: differences, the dense solve, forward mode."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
from diffusion.problems import random_system
from helpers import check_gradient, lean, random_like

from mvedge_jax.diffusion import (
    AutoSolver,
    Elimination,
    Multigrid,
    System,
    diffuse,
    linear_operator,
)

TIGHT = AutoSolver(tolerance=1e-13)
SHAPE = (9, 11)


def positive_system(key):
    """Away from zero weights, where a step would make the matrix indefinite."""
    system = random_system(*SHAPE, contrast=1.0, key=key)
    keys = jax.random.split(key)
    tx, ty = system.tx + 0.1, system.ty + 0.1
    rises = (jax.random.normal(k, t.shape) for k, t in zip(keys, (tx, ty), strict=True))
    return System(system.weight + 0.1, system.label, tx, ty, *rises)


def uneven_system(key):
    """Without rises, and with pixels that have no data."""
    return random_system(*SHAPE, contrast=1.0, key=key)


def dense(system):
    """The solution by a dense factorisation that JAX differentiates by itself."""
    size = system.weight.size
    identity = jnp.eye(size).reshape(size, *system.shape)
    matrix = jax.vmap(system.matvec)(identity).reshape(size, size)
    return jnp.linalg.solve(matrix, system.right_hand_side().ravel()).reshape(system.shape)


def loss_of(solve):
    target = jax.random.normal(jax.random.key(2), SHAPE)
    return lambda system: jnp.sum((solve(system) - target) ** 2)


def implicit(system):
    return diffuse(system, solver=TIGHT).value


@pytest.mark.parametrize("name", ["weight", "label", "tx", "ty", "rise_x", "rise_y"])
def test_gradient_equals_differences(name):
    system = positive_system(jax.random.key(1))

    def loss(array):
        return loss_of(implicit)(eqx.tree_at(lambda s: getattr(s, name), system, array))

    check_gradient(loss, getattr(system, name), rtol=1e-6, step=1e-5, key=jax.random.key(3))


@pytest.mark.parametrize("make", [positive_system, uneven_system])
def test_gradient_equals_dense_solve(make):
    system = make(jax.random.key(4))
    found = jax.grad(loss_of(implicit))(system)
    expected = jax.grad(loss_of(dense))(system)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert float(jnp.abs(a - b).max()) < 1e-9 * float(jnp.abs(b).max())


@pytest.mark.parametrize("make", [positive_system, uneven_system])
def test_forward_mode_agrees(make):
    system = make(jax.random.key(5))
    direction = random_like(system, key=jax.random.key(6))
    value, tangent = jax.jvp(implicit, (system,), (direction,))
    # Another program, in which the compiler may add in another order.
    np.testing.assert_allclose(value, implicit(system), rtol=0, atol=1e-14)
    _, expected = jax.jvp(dense, (system,), (direction,))
    np.testing.assert_allclose(
        tangent, expected, rtol=0, atol=1e-9 * float(jnp.abs(expected).max())
    )


def test_second_derivative():
    system = positive_system(jax.random.key(7))
    direction = random_like(system, key=jax.random.key(8))

    def along(solve):
        def line(t):
            return loss_of(solve)(jax.tree.map(lambda a, b: a + t * b, system, direction))

        return float(jax.jvp(lambda t: jax.jvp(line, (t,), (1.0,))[1], (0.0,), (1.0,))[1])

    assert along(implicit) == pytest.approx(along(dense), rel=1e-8)


# Multigrid, exact elimination, and both of them with parts that nothing ties to data.
CASES = {
    "multigrid": ((40, 44), Multigrid, False),
    "thin": ((6, 50), Elimination, False),
    "isolated": ((20, 24), Multigrid, True),
    "thin, isolated": ((5, 24), Elimination, True),
}


def _case(name):
    shape, kind, isolated = CASES[name]
    system = random_system(*shape, contrast=1.0, key=jax.random.key(11))
    system = System(system.weight + 0.1, system.label, system.tx + 0.1, system.ty + 0.1)
    if isolated:  # a block of 3x3 pixels without data or ties
        weight, tx, ty = (a.at[1:4, 1:4].set(0) for a in (system.weight, system.tx, system.ty))
        tx, ty = tx.at[1:4, 0].set(0), ty.at[0, 1:4].set(0)
        system = System(weight, system.label, tx, ty)
    solver = kind(tolerance=1e-13)
    target = jax.random.normal(jax.random.key(12), shape)
    # Zero weights stay zero: a step would make the matrix indefinite or tie what was not.
    direction = jax.tree.map(
        lambda a, b: jnp.where(a != 0, b, 0), system, random_like(system, key=jax.random.key(13))
    )

    def loss(system):
        return jnp.sum(jnp.sin(diffuse(system, solver=solver).value - target) ** 2)

    def line(t):
        return loss(jax.tree.map(lambda a, b: a + t * b, system, direction))

    return system, direction, loss, line


@pytest.mark.parametrize("name", CASES)
def test_compositions_of_both_modes(name):
    system, direction, loss, line = _case(name)
    step = 1e-5
    numeric = (line(step) - line(-step)) / (2 * step)
    value, forward = jax.jvp(loss, (system,), (direction,))
    gradient = lean(jax.grad(loss))(system)
    pairs = zip(*map(jax.tree.leaves, (gradient, direction)), strict=True)
    reverse = sum(jnp.vdot(a, b) for a, b in pairs)
    linear_value, linear = jax.linearize(loss, system)
    assert float(forward) == pytest.approx(float(numeric), rel=1e-6)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-9)
    assert float(linear(direction)) == pytest.approx(float(forward), rel=1e-9)
    assert float(linear_value) == pytest.approx(float(value), rel=1e-14)
    assert float(jax.jacfwd(line)(0.0)) == pytest.approx(float(forward), rel=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_forward_over_reverse_equals_differences_of_the_gradient(name):
    system, direction, loss, _ = _case(name)
    step = 1e-5

    @lean
    def gradient_at(t):
        return jax.grad(loss)(jax.tree.map(lambda a, b: a + t * b, system, direction))

    numeric = jax.tree.map(lambda a, b: (a - b) / (2 * step), gradient_at(step), gradient_at(-step))
    _, tangent = jax.jvp(jax.grad(loss), (system,), (direction,))
    for leaf, found, expected in zip(
        *map(jax.tree.leaves, (system, tangent, numeric)), strict=True
    ):
        assert bool(jnp.isfinite(found).all())
        # An edge that would tie an isolated part to the rest makes the map jump.
        found, expected = jnp.where(leaf != 0, found, 0), jnp.where(leaf != 0, expected, 0)
        np.testing.assert_allclose(
            found, expected, rtol=0, atol=1e-6 * float(jnp.abs(expected).max())
        )


@pytest.mark.parametrize("field", ["weight", "label", "tx"])
def test_forward_over_reverse_in_one_field_alone(field):
    """The others are constants, whose tangents JAX leaves out of the solve."""
    system, direction, loss, _ = _case("multigrid")

    def of(values):
        return loss(eqx.tree_at(lambda tree: getattr(tree, field), system, values))

    own, along, step = getattr(system, field), getattr(direction, field), 1e-5
    _, found = jax.jvp(jax.grad(of), (own,), (along,))
    after, before = (jax.grad(of)(own + t * along) for t in (step, -step))
    expected = (after - before) / (2 * step)
    assert bool(jnp.isfinite(found).all())
    assert bool((expected != 0).any())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * float(jnp.abs(expected).max()))


def test_reverse_over_reverse_equals_the_dense_solve():
    system = positive_system(jax.random.key(14))
    direction = random_like(system, key=jax.random.key(15))

    def along(solve):
        def slope(system):
            gradient = jax.grad(loss_of(solve))(system)
            leaves = zip(*map(jax.tree.leaves, (gradient, direction)), strict=True)
            return sum(jnp.vdot(a, b) for a, b in leaves)

        return jax.grad(slope)(system)

    for a, b in zip(*map(jax.tree.leaves, (along(implicit), along(dense))), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-8 * float(jnp.abs(b).max()))


@pytest.mark.parametrize("shape", [(6, 50), (40, 44)])
def test_directions_under_vmap(shape):
    system = random_system(*shape, contrast=1.0, key=jax.random.key(16))
    directions = [random_like(system, key=jax.random.key(k)) for k in (17, 18, 19)]

    def push(direction):
        return jax.jvp(lambda s: diffuse(s, solver=TIGHT).value, (system,), (direction,))[1]

    together = jax.vmap(push)(jax.tree.map(lambda *maps: jnp.stack(maps), *directions))
    for found, direction in zip(together, directions, strict=True):
        expected = push(direction)
        np.testing.assert_allclose(
            found, expected, rtol=0, atol=1e-9 * float(jnp.abs(expected).max())
        )


@pytest.mark.parametrize("shape", [(64, 64), (9, 64)])
@pytest.mark.parametrize("by_residual", [False, True])
def test_a_loss_of_any_size_has_its_gradient(shape, by_residual):
    """In float32, the precision that ships."""
    system = random_system(*shape, contrast=1.0, key=jax.random.key(20))
    system = jax.tree.map(lambda a: a.astype(jnp.float32), system)
    target = jax.random.normal(jax.random.key(21), shape, jnp.float32)
    solver = AutoSolver(by_residual=by_residual)

    @lean
    def gradient(scale):
        def loss(system):
            difference = diffuse(system, solver=solver).value - target
            return scale * jnp.mean(difference * difference)

        return jax.tree.leaves(jax.grad(loss)(system))

    expected = gradient(jnp.float32(1))
    for power in (-30, -20, -18, -10, 10, 18, 20, 30):
        scale = np.float64(10.0**power)
        for a, b in zip(gradient(jnp.float32(scale)), expected, strict=True):
            found = np.asarray(a, np.float64) / np.float64(np.float32(scale))
            error = np.abs(found - np.asarray(b, np.float64)).max()
            assert error <= 1e-5 * float(jnp.abs(b).max()), f"1e{power}: {error:.2e}"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_cotangent_that_is_not_finite_does_not_pass_for_zero(value):
    system = random_system(20, 20, key=jax.random.key(22))
    factor = jnp.ones(system.shape).at[3, 3].set(value)
    gradient = jax.grad(lambda s: jnp.sum(factor * diffuse(s).value))(system)
    assert bool(jnp.isnan(gradient.label).any())


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("kind", [Multigrid, Elimination])
def test_lineax_says_how_an_adjoint_solve_went(kind, scale):
    system = random_system(12, 15, contrast=1.0, key=jax.random.key(23))
    operator = linear_operator(system)
    cotangent = scale * jax.random.normal(jax.random.key(24), system.shape)
    found = lx.linear_solve(operator, cotangent, kind(tolerance=1e-10))
    rest = cotangent - system.matvec(found.value)
    assert float(jnp.linalg.norm(rest)) < 1e-8 * float(jnp.linalg.norm(cotangent))
    assert float(found.stats["estimate"]) < 2e-10 * float(jnp.abs(found.value).max())


@pytest.mark.parametrize(
    "adjoint",
    [AutoSolver(tolerance=1e-13), lx.CG(1e-13, 1e-13)],
    ids=lambda solver: type(solver).__name__,
)
def test_the_adjoint_may_be_another_solver(adjoint):
    """The solve itself is so coarse that its own solver would not do for the derivatives."""
    system = positive_system(jax.random.key(25))
    cotangent = jax.random.normal(jax.random.key(26), SHAPE)

    def loss(solve):
        return lambda label: jnp.vdot(
            solve(eqx.tree_at(lambda s: s.label, system, label)), cotangent
        )

    def coarse(system):
        return diffuse(system, solver=Multigrid(tolerance=0.3), adjoint=adjoint).value

    found, expected = (jax.grad(loss(solve))(system.label) for solve in (coarse, dense))
    size = float(jnp.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)
    own = jax.grad(loss(lambda s: diffuse(s, solver=Multigrid(tolerance=0.3)).value))(system.label)
    assert float(jnp.abs(own - expected).max()) > 1e-6 * size


def test_statistics_have_no_gradient():
    system = random_system(*SHAPE, key=jax.random.key(9))
    gradient = jax.grad(lambda s: diffuse(s).stats.estimate)(system)
    assert all(float(jnp.abs(leaf).max()) == 0 for leaf in jax.tree.leaves(gradient))
    _, tangent = jax.jvp(lambda s: diffuse(s).stats.residual, (system,), (system,))
    assert float(tangent) == 0


def test_gradient_under_vmap():
    systems = [random_system(*SHAPE, key=jax.random.key(i)) for i in range(2)]
    batch = jax.tree.map(lambda *maps: jnp.stack(maps), *systems)
    together = jax.vmap(jax.grad(loss_of(implicit)))(batch)
    alone = jax.grad(loss_of(implicit))(systems[1])
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a[1], b, rtol=0, atol=1e-9 * float(jnp.abs(b).max()))
