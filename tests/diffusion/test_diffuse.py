"""The solve against direct solves, its gradients, and its transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse.linalg
from helpers import check_gradient

from mvedge_jax.diffusion import Solver, System, diffuse

TIGHT = Solver(tolerance=1e-12)


def random_system(y, x, *, contrast=2.0, data=0.2, dtype=jnp.float64, key):
    """Sparse labels with weights and edges from log-normal distributions."""
    keys = jax.random.split(key, 5)
    weight = jnp.exp(3 * jax.random.normal(keys[0], (y, x)))
    weight = jnp.where(jax.random.uniform(keys[1], (y, x)) < data, weight, 0).at[0, 0].set(1.0)
    system = System(
        weight,
        jax.random.normal(keys[2], (y, x)),
        jnp.exp(contrast * jax.random.normal(keys[3], (y, x - 1))),
        jnp.exp(contrast * jax.random.normal(keys[4], (y - 1, x))),
    )
    return jax.tree.map(lambda a: a.astype(dtype), system)


def direct(system):
    right = np.asarray(system.right_hand_side(), np.float64).ravel()
    solution = scipy.sparse.linalg.spsolve(system.to_scipy().tocsc(), right)
    return np.asarray(solution).reshape(system.shape)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (9, 1), (2, 2), (5, 8), (37, 53)])
def test_equals_direct_solve(shape):
    system = random_system(*shape, key=jax.random.key(0))
    found = diffuse(system, solver=TIGHT)
    assert bool(found.stats.converged)
    np.testing.assert_allclose(found.value, direct(system), rtol=0, atol=1e-10)


def test_gradient_equals_differences():
    system = random_system(13, 17, key=jax.random.key(1))
    # Away from zero weights, where a step would make the matrix indefinite.
    system = System(system.weight + 0.1, system.label, system.tx + 0.1, system.ty + 0.1)
    target = jax.random.normal(jax.random.key(2), system.shape)

    def loss(system):
        return jnp.sum((diffuse(system, solver=TIGHT).value - target) ** 2)

    check_gradient(loss, system, rtol=1e-6, step=1e-5, key=jax.random.key(3))
