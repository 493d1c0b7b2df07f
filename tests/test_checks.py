"""Numbers in parameters: checked outside of `jit`, told inside, never compiled anew."""

import logging
import re
import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float

from mvedge_jax import _checks
from mvedge_jax._checks import checked_jit, expect, sound, with_numbers
from mvedge_jax._params import number


class _Inner(eqx.Module):
    sigma: Float[Array, ""] = number(2.0, "px")
    taps: Float[Array, " k"] = eqx.field(default_factory=lambda: jnp.asarray([-1.0, 1.0]))


class _Outer(eqx.Module):
    inner: _Inner = eqx.field(default_factory=_Inner)
    pair: tuple[_Inner, _Inner] | None = None
    weight: Float[Array, "2"] = number((0.0, 1.0))


def _look(params, scale):
    return (with_numbers(params), scale), {}


@checked_jit(_look)
def _product(params: _Outer, scale: float) -> Array:
    return jnp.where(sound(params), params.inner.sigma * scale, 0)


def test_a_python_number_compiles_once():
    before = _product.traces
    for value in (1.0, 2.0, 3, jnp.asarray(4.0), jnp.float64(5.0)):
        params = eqx.tree_at(lambda p: p.inner.sigma, _Outer(), value)
        assert float(_product(params, jnp.asarray(2.0))) == 2 * float(value)
    assert _product.traces == before + 1


def test_a_program_made_ahead_looks_at_its_arguments():
    lowered = _product.lower(_Outer(), jnp.asarray(2.0))
    assert "stablehlo" in lowered.as_text()
    program = lowered.compile()
    params = eqx.tree_at(lambda p: p.inner.sigma, _Outer(), 3)
    assert float(program(params, jnp.asarray(2.0))) == 6
    bad = eqx.tree_at(lambda p: p.inner.sigma, _Outer(), -3.0)
    with pytest.raises(ValueError, match="sigma"):
        program(bad, jnp.asarray(2.0))


def test_a_call_that_compiles_for_long_says_so_once(monkeypatch, caplog):
    monkeypatch.setattr(_checks, "_PATIENCE", 0.05)

    @checked_jit(_look)
    def slow(params: _Outer, scale: Array) -> Array:
        time.sleep(0.3)
        return params.inner.sigma * scale

    with caplog.at_level(logging.WARNING, "mvedge_jax"):
        slow(_Outer(), jnp.asarray(1.0))
        first, second = (record.getMessage() for record in caplog.records)
        assert first == "slow is being compiled for arguments of this shape, once."
        assert second.startswith("slow was compiled in ")
        caplog.clear()
        slow(_Outer(), jnp.asarray(2.0))
        # Within `jit` whoever compiles that has the say.
        jax.jit(lambda scale: slow(_Outer(), scale))(jnp.ones(2))
        assert not caplog.records


PLACES = {
    "inner.sigma": lambda p: p.inner.sigma,
    "weight": lambda p: p.weight,
    "pair[1].sigma": lambda p: p.pair[1].sigma,
}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0])
@pytest.mark.parametrize("where", PLACES)
def test_what_is_no_number_is_named(where, value):
    bad = jnp.asarray([0.0, value]) if where == "weight" else value
    params = eqx.tree_at(PLACES[where], _Outer(pair=(_Inner(), _Inner())), bad)
    with pytest.raises(ValueError, match=f"`{re.escape(where)}` must be finite and not negative"):
        with_numbers(params)
    assert not bool(jax.jit(sound)(jax.tree.map(jnp.asarray, params)))


def test_filters_may_be_negative_but_not_nan_and_become_strongly_typed():
    assert bool(sound(with_numbers(_Outer())))
    wrong = eqx.tree_at(lambda p: p.inner.taps, _Outer(), jnp.asarray([jnp.nan, 1.0]))
    with pytest.raises(ValueError, match=r"`inner.taps` must be finite, got nan"):
        with_numbers(wrong)
    params = eqx.tree_at(lambda p: p.pair[1].sigma, _Outer(pair=(_Inner(), _Inner())), 3)
    found = with_numbers(params)
    assert found.pair is not None
    assert float(found.pair[1].sigma) == 3
    assert not found.pair[1].sigma.weak_type


class _Network(eqx.Module):
    """A user's part: its own constructor, layers in a list, functions among its leaves."""

    layers: list
    scale: Array
    last: Callable

    def __init__(self, key):
        self.layers = [eqx.nn.Linear(2, 2, key=key), jax.nn.relu, eqx.nn.MLP(2, 2, 2, 1, key=key)]
        self.scale = jnp.ones(())
        self.last = jnp.tanh


def test_a_network_of_the_users_is_looked_at():
    network = _Network(jax.random.key(0))
    assert with_numbers(network) is network
    assert bool(eqx.filter_jit(sound)(network))
    broken = eqx.tree_at(lambda n: n.layers[2].layers[0].weight, network, jnp.full((2, 2), jnp.nan))
    with pytest.raises(
        ValueError, match=r"`layers\[2\].layers\[0\].weight` must be finite, got nan"
    ):
        with_numbers(broken)
    assert not bool(eqx.filter_jit(sound)(broken))


def test_tracers_pass_and_derivatives_too():
    found = jax.grad(lambda p: _product(p, jnp.asarray(3.0)))(_Outer())
    assert float(found.inner.sigma) == 3.0
    params = eqx.filter_vmap(lambda s: _Outer(inner=_Inner(sigma=s)))(jnp.asarray([1.0, -1.0]))
    values = jax.vmap(lambda p: _product(p, jnp.asarray(1.0)))(params)
    assert values.tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "None"), (jnp.zeros((2, 3)), r"an array of shape \(2, 3\)"), (_Inner(), "_Inner")],
)
def test_kinds_are_named(value, text):
    with pytest.raises(TypeError, match=f"`params` must be _Outer, got {text}; make one."):
        expect("params", value, _Outer, "make one")
