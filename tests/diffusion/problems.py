"""Systems for the tests of diffusion, and their direct solutions."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.linalg

from mvedge_jax.diffusion import System, edge_weights


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


def cut_discs(size, *, seed=0):
    """Discs at heights of their own, smooth inside and all but cut off at their outlines."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[:size, :size]
    height = np.zeros((size, size))
    for _ in range(25):
        y, x, radius = *random.uniform(0, size, 2), random.uniform(0.04, 0.2) * size
        height[(rows - y) ** 2 + (columns - x) ** 2 < radius**2] = random.uniform(-1.5, 1.5)
    outline = np.diff(height, axis=0, prepend=0) != 0
    outline |= np.diff(height, axis=1, prepend=0) != 0
    weight = np.where(outline & (random.uniform(size=height.shape) < 0.4), 1e5, 0.0)
    weight[0, 0] = 1e5
    smoothness = jnp.asarray(np.where(outline, 1e-5, 1e4))
    return System(jnp.asarray(weight), jnp.asarray(height), *edge_weights(smoothness))


def direct(system):
    """The exact solution, SciPy in float64."""
    right = np.asarray(system.right_hand_side(), np.float64).ravel()
    solution = scipy.sparse.linalg.spsolve(system.to_scipy().tocsc(), right)
    return np.asarray(solution).reshape(system.shape)
