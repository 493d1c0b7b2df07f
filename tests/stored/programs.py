"""Small functions whose programs are kept, and how tests run them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax._compiler import lean_jit
from mvedge_jax._split_jit import Halves, SplitJit

TRACES = []


class Part(eqx.Module):
    weight: Any
    power: Any = eqx.field(static=True, default=2)


class Found(eqx.Module):
    power: jax.Array
    name: str = eqx.field(static=True)
    nothing: None
    text: str


def powers(x, part, *, key=None):
    TRACES.append("trace")
    noise = 0 if key is None else jax.random.normal(key, x.shape, x.dtype)
    power = x**part.power if isinstance(part.power, int) else part.power(x)
    return {"a": Found(part.weight * power + noise, "powers", None, "said"), "b": (x.sum(), 3)}


def told(x):
    jax.debug.callback(lambda: TRACES.append("told"))
    return x + 1


def asked(x):
    return jax.pure_callback(lambda x: np.asarray(x) + 1, jax.ShapeDtypeStruct(x.shape, x.dtype), x)


def refused(x):
    return eqx.error_if(x, x < 0, "negative")


def listed(x, kinds):
    return x * len(kinds)


def summed(x):
    return x.sum()


CONSTANT = np.arange(3.0)


def with_constant(x):
    return x + jnp.asarray(CONSTANT)


def stored_files(files):
    return sorted(files.folder.glob("*.program"))


def run(*arguments, function=powers, **options):
    """A call as in a new process, and how often the function was traced."""
    before = len(TRACES)
    result = jax.block_until_ready(lean_jit(function)(*arguments, **options))
    return result, len(TRACES) - before


def same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert type(x) is type(y)
        np.testing.assert_array_equal(x, y)
        for about in ("dtype", "weak_type", "committed", "sharding"):
            assert getattr(x, about, None) == getattr(y, about, None)


X = jnp.linspace(-1.0, 1.0, 7)


def split(x, part, *, key=None):
    return (x, part.weight, key), (part.power,)


def scaled(x, weight, key):
    TRACES.append("first")
    noise = 0 if key is None else jax.random.normal(key, x.shape, x.dtype)
    return Found(weight * x + noise, "scaled", None, "said"), {"sum": x.sum(), "weak": 2 * weight}


def raised(found, power):
    TRACES.append("second")
    first, also = found
    # As a Python number in the program itself, a weak type stays one between the halves.
    return {"a": first.power**power if isinstance(power, int) else power(first.power)} | also


def chain(x, part, *, key=None):
    first, rest = split(x, part, key=key)
    return raised(scaled(*first), *rest)


def split_jit():
    """As in a new process."""
    return SplitJit(chain, chain, Halves(split, scaled, raised), lambda half: half)
