"""A linear map with its own transpose under every composition of transforms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import random_like

from mvedge_jax._linear_map import linear_map

FIXED = {"matrix": jax.random.normal(jax.random.key(0), (3, 4)), "order": jnp.array([2, 0, 1])}
MOVING = {"x": jax.random.normal(jax.random.key(1), (4,)), "y": jnp.asarray(0.7)}


def forward(fixed, moving):
    """Depends on `fixed` in a nonlinear way, through a loop that JAX cannot transpose."""

    def add(k, total):
        return total + jnp.sin(fixed["matrix"][:, k]) * moving["x"][k]

    total = jax.lax.fori_loop(0, fixed["order"].max() + 2, add, jnp.zeros(3))
    return total[fixed["order"]], moving["y"] * fixed["matrix"][0, 0]


def transpose(fixed, cotangent):
    out, scalar = cotangent
    moved = jnp.zeros(3).at[fixed["order"]].add(out)
    return {"x": jnp.sin(fixed["matrix"]).T @ moved, "y": scalar * fixed["matrix"][0, 0]}


def ours(fixed, moving):
    return linear_map(forward, transpose, fixed, moving)


def plain(fixed, moving):
    out = (jnp.sin(fixed["matrix"]) @ moving["x"])[fixed["order"]]
    return out, moving["y"] * fixed["matrix"][0, 0]


def _fixed(matrix):
    return {"matrix": matrix, "order": FIXED["order"]}


def _loss(function, matrix, moving):
    out, scalar = function(_fixed(matrix), moving)
    return jnp.sum(jnp.cos(out)) + scalar**2


MATRIX = FIXED["matrix"]
D_MATRIX = jax.random.normal(jax.random.key(2), MATRIX.shape)
D_MOVING = random_like(MOVING, key=jax.random.key(3))

PAIR = jnp.stack([MATRIX, D_MATRIX])


def _scanned(function, moving):
    """Losses of the moving part times 0, 1 and 2, added in a scan."""

    def add(total, scale):
        scaled = jax.tree.map(lambda x: scale * x, moving)
        return total + _loss(function, MATRIX, scaled), None

    return jax.lax.scan(add, 0.0, jnp.arange(3.0))[0]


COMPOSITIONS = {
    "grad": lambda f: jax.grad(_loss, 2)(f, MATRIX, MOVING),
    "jvp, both": lambda f: jax.jvp(
        lambda a, m: f(_fixed(a), m), (MATRIX, MOVING), (D_MATRIX, D_MOVING)
    ),
    "jvp of grad": lambda f: jax.jvp(
        lambda a, m: jax.grad(_loss, 2)(f, a, m), (MATRIX, MOVING), (D_MATRIX, D_MOVING)
    ),
    "grad of grad": lambda f: jax.grad(
        lambda m: sum(jnp.sum(g**2) for g in jax.tree.leaves(jax.grad(_loss, 2)(f, MATRIX, m)))
    )(MOVING),
    "linearize": lambda f: jax.linearize(lambda m: f(FIXED, m), MOVING)[1](D_MOVING),
    "vmap of grad": lambda f: jax.vmap(lambda a: jax.grad(_loss, 2)(f, a, MOVING))(PAIR),
    "grad of vmap": lambda f: jax.grad(
        lambda m: jax.vmap(lambda a: _loss(f, a, m), in_axes=1)(jnp.moveaxis(PAIR, 0, 1)).sum()
    )(MOVING),
    "grad through scan": lambda f: jax.grad(lambda m: _scanned(f, m))(MOVING),
}


@pytest.mark.parametrize("name", COMPOSITIONS)
def test_compositions(name):
    expected, plainly = COMPOSITIONS[name](plain), COMPOSITIONS[name](ours)
    jitted = jax.jit(lambda: COMPOSITIONS[name](ours))()
    for found in (plainly, jitted):
        for x, y in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(x, y, rtol=0, atol=1e-12)
