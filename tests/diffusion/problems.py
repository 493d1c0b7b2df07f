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


def direct(system):
    """The exact solution, SciPy in float64."""
    right = np.asarray(system.right_hand_side(), np.float64).ravel()
    solution = scipy.sparse.linalg.spsolve(system.to_scipy().tocsc(), right)
    return np.asarray(solution).reshape(system.shape)
