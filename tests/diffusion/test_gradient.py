"""Gradients: differences, the dense solve, forward mode."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffusion.problems import random_system
from helpers import check_gradient, random_like

from mvedge_jax.diffusion import Solver, System, diffuse, diffuse_forward_mode

TIGHT = Solver(tolerance=1e-13)
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


def dual(system):
    return diffuse_forward_mode(system, solver=TIGHT).value


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
    value, tangent = jax.jvp(dual, (system,), (direction,))
    np.testing.assert_array_equal(value, implicit(system))
    _, expected = jax.jvp(dense, (system,), (direction,))
    np.testing.assert_allclose(
        tangent, expected, rtol=0, atol=1e-9 * float(jnp.abs(expected).max())
    )
    gradient = jax.grad(loss_of(dual))(system)
    expected = jax.grad(loss_of(implicit))(system)
    for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * float(jnp.abs(b).max()))


def test_second_derivative():
    system = positive_system(jax.random.key(7))
    direction = random_like(system, key=jax.random.key(8))

    def along(solve):
        def line(t):
            return loss_of(solve)(jax.tree.map(lambda a, b: a + t * b, system, direction))

        return float(jax.jvp(lambda t: jax.jvp(line, (t,), (1.0,))[1], (0.0,), (1.0,))[1])

    assert along(dual) == pytest.approx(along(dense), rel=1e-8)


def test_statistics_have_no_gradient():
    system = random_system(*SHAPE, key=jax.random.key(9))
    gradient = jax.grad(lambda s: diffuse(s).stats.estimate)(system)
    assert all(float(jnp.abs(leaf).max()) == 0 for leaf in jax.tree.leaves(gradient))
    _, tangent = jax.jvp(lambda s: diffuse_forward_mode(s).stats.residual, (system,), (system,))
    assert float(tangent) == 0


def test_gradient_under_vmap():
    systems = [random_system(*SHAPE, key=jax.random.key(i)) for i in range(2)]
    batch = jax.tree.map(lambda *maps: jnp.stack(maps), *systems)
    together = jax.vmap(jax.grad(loss_of(implicit)))(batch)
    alone = jax.grad(loss_of(implicit))(systems[1])
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a[1], b, rtol=0, atol=1e-9 * float(jnp.abs(b).max()))
