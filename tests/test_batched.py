"""Many settings: equal to the loop, once what no row reaches, in the memory of a few."""

import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes
from jax import lax

from mvedge_jax import _batched, batched

SHARED = jnp.linspace(0.0, 1.0, 7)


def _grown(row, shared):
    """A step that no row reaches, steps in a `jit`, and a loop that rows leave at their time."""
    start, end = row
    ends = lax.scan(lambda carry, x: (carry + x, carry * x), 0.0, jnp.sin(shared))[1]
    mixed = jax.jit(lambda x, a: jnp.cos(x) + a)(ends, start)
    grown = lax.while_loop(lambda x: x.sum() < end, lambda x: x + 1, mixed)
    return {"grown": grown, "shared": ends, "row": start, "constant": 3.0}


@pytest.mark.parametrize("together", [None, 1, 2, 8])
def test_it_is_the_loop(together):
    rows = jnp.arange(5.0), jnp.linspace(1.0, 20.0, 5)
    found = batched(_grown, together=together)(rows, SHARED)
    loop = [_grown((a, b), SHARED) for a, b in zip(*rows, strict=True)]
    expected = jax.tree.map(lambda *leaves: jnp.stack(list(map(jnp.asarray, leaves))), *loop)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize(("together", "calls"), [(1, 6), (2, 3), (4, 2)])
def test_what_no_row_reaches_is_computed_once(together, calls):
    counted = {"shared": 0, "row": 0}

    def noted(name):
        counted[name] += 1

    def one(row, shared):
        jax.debug.callback(lambda: noted("shared"))
        common = jnp.sum(jnp.exp(shared))
        # A callback under `vmap` is called for every row that goes along.
        return jax.pure_callback(
            lambda x: (noted("row"), x)[1], jax.typeof(row), row * common, vmap_method="expand_dims"
        )

    rows = jnp.arange(6.0)
    found = batched(one, together=together)(rows, SHARED)
    jax.effects_barrier()
    np.testing.assert_allclose(found, rows * jnp.exp(SHARED).sum())
    assert counted == {"shared": 1, "row": calls}


def test_memory_is_that_of_the_rows_that_go_together():
    def one(row, shared):
        waves = jnp.sin(row * shared[:, None] + jnp.arange(4096.0)[None])
        return jnp.sum(lax.cumsum(waves, axis=1) ** 2)

    def temporary(function, rows):
        program = jax.jit(function).lower(rows, SHARED).compile()
        memory: Any = program.memory_analysis()
        return memory.temp_size_in_bytes

    rows = jnp.linspace(0.0, 1.0, 64)
    alone = temporary(one, rows[0])
    assert temporary(jax.vmap(one, in_axes=(0, None)), rows) > 30 * alone
    for together in (1, 4, 8):
        assert temporary(batched(one, together=together), rows) < (together + 1) * alone


def test_derivatives_in_rows_and_in_what_they_share():
    def loss(tree):
        rows, shared = tree
        found = batched(lambda row, s: jnp.sum(jnp.sin(row * s)) ** 2, together=2)(rows, shared)
        return jnp.sum(found * jnp.arange(1.0, 4.0))

    check_modes(loss, (jnp.asarray([0.3, 0.8, 1.7]), SHARED), rtol=1e-6, key=jax.random.key(0))


def test_large_arrays_go_alone_on_the_cpu_and_by_the_eight_elsewhere(monkeypatch):
    def groups(size):
        traced = jax.make_jaxpr(lambda rows: batched(lambda r: jnp.ones(size) * r)(rows))
        return str(traced(jnp.zeros(64))).split("length=")[1].split()[0]

    assert groups(_batched._NUMBERS) == "64"
    assert groups(_batched._NUMBERS // 4) == "16"
    assert groups(1) == "8"
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert groups(_batched._NUMBERS) == "8"


def test_no_rows_give_none():
    assert batched(lambda row: row[:2])(jnp.zeros((0, 3))).shape == (0, 2)


LENGTHS = "`rows` must have one leading axis in all of its leaves"


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        ((), {}, LENGTHS),
        ((jnp.zeros(2), jnp.zeros(3)), {}, LENGTHS),
        ((jnp.zeros(2), jnp.asarray(1.0)), {}, LENGTHS),
        (jnp.zeros(2), {"together": 0}, "`together` must be at least 1, got 0"),
        (jnp.zeros(2), {"devices": []}, "`devices` must have one device at least, got none"),
    ],
)
def test_mistakes_are_told(rows, options, message):
    with pytest.raises(ValueError, match=message):
        batched(lambda row: row, **options)(rows)


SPREAD = """
import jax
import jax.numpy as jnp

jax.config.update("jax_num_cpu_devices", 2)
from mvedge_jax import _batched, batched


def grown(row, shared, name):
    assert name == "a"
    return {"row": jax.lax.fori_loop(0, 3, lambda i, x: x + row, shared), "shared": shared.sum()}


shared = jnp.linspace(0.0, 1.0, 7)
for size in (1, 4, 5):
    rows = jnp.arange(float(size))
    found = batched(grown, devices=jax.devices())(rows, shared, "a")
    assert size % 2 or len(found["row"].sharding.device_set) == 2
    alone = batched(grown)(rows, shared, "a")
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
        assert a.shape == b.shape
        assert bool((a == b).all())
"""


def test_rows_on_two_devices_are_those_on_one():
    ran = subprocess.run([sys.executable, "-c", SPREAD], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
