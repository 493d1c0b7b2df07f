"""Systems for the tests of diffusion, and their direct solutions."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.linalg

from mvedge_jax.diffusion import System


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


def positive_system(y, x, *, key):
    """Away from zero weights, where a step would make the matrix indefinite."""
    system = random_system(y, x, contrast=1.0, key=key)
    return System(system.weight + 0.1, system.label, system.tx + 0.1, system.ty + 0.1)


def stacked(systems):
    """Systems of one shape as a batch."""
    return jax.tree.map(lambda *maps: jnp.stack(maps), *systems)


def member(batch, i):
    """One system of a batch."""
    return jax.tree.map(lambda maps: maps[i], batch)


def direct(system):
    """The exact solution, SciPy in float64."""
    right = np.asarray(system.right_hand_side(), np.float64).ravel()
    solution = scipy.sparse.linalg.spsolve(system.to_scipy().tocsc(), right)
    return np.asarray(solution).reshape(system.shape)


def dense(system, right=None):
    """The solution by a dense factorization, which JAX differentiates by itself."""
    right = system.right_hand_side() if right is None else right
    identity = jnp.eye(right.size).reshape(right.size, *system.shape)
    matrix = jax.vmap(system.matvec)(identity).reshape(right.size, right.size)
    return jnp.linalg.solve(matrix, right.ravel()).reshape(system.shape)
