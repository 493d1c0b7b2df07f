"""Traced hyperparameters."""

import equinox as eqx
import jax
import jax.numpy as jnp
from helpers import count_traces
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number


class _Stage(eqx.Module):
    sigma: Float[Array, ""] = number(0.85)
    weights: Float[Array, "3"] = number((1.0, 2.0, 3.0))


def test_values_do_not_retrace():
    function, traces = count_traces(lambda stage: stage.sigma * stage.weights.sum())
    assert function(_Stage()) == 0.85 * 6
    assert function(_Stage(sigma=jnp.asarray(2.0))) == 12
    assert function(_Stage(sigma=jnp.asarray(3.0, jnp.float64))) == 18
    updated = jax.tree.map(lambda leaf: leaf * 2, _Stage())
    function(updated)
    assert traces() == 1


def test_gradient_and_vmap_reach_them():
    gradient = jax.grad(lambda stage: stage.sigma**2)(_Stage(sigma=jnp.asarray(3.0)))
    assert gradient.sigma == 6
    many = eqx.filter_vmap(lambda s: _Stage(sigma=s))(jnp.arange(4.0))
    assert eqx.filter_vmap(lambda stage: stage.sigma)(many).shape == (4,)


def test_cast_follows_the_data():
    stage = cast(_Stage(), jnp.float32)
    assert stage.sigma.dtype == jnp.float32
    assert jax.grad(lambda s: cast(s, jnp.float32).sigma)(_Stage()).sigma == 1
