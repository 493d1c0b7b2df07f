"""Two programs in a row are what the whole would be, each compiled for arguments of its own."""

import time
import weakref
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored.programs import TRACES, Part, X, chain, same, split_jit, stored_files


def _traced(program, *arguments, **options):
    """A result, and which halves were traced for it."""
    before = len(TRACES)
    return program(*arguments, **options), TRACES[before:]


@pytest.mark.parametrize("key", [None, jax.random.key(3)], ids=["no key", "key"])
def test_the_halves_give_what_the_whole_gives(key):
    part = Part(jnp.asarray(2.0))
    same(split_jit()(X, part, key=key), eqx.filter_jit(chain)(X, part, key=key))


def test_a_half_is_traced_for_other_arguments_of_its_own():
    program, part = split_jit(), Part(jnp.asarray(2.0))
    assert _traced(program, X, part)[1] == ["first", "second"]
    found, traced = _traced(program, X + 1, Part(jnp.asarray(3.0)))
    np.testing.assert_allclose(found["a"], (3 * (X + 1)) ** 2)
    assert traced == []
    found, traced = _traced(program, X, Part(jnp.asarray(2.0), power=3))
    np.testing.assert_allclose(found["a"], (2 * X) ** 3)
    assert traced == ["second"]
    assert _traced(program, X[:3], part)[1] == ["first", "second"]
    jax.clear_caches()
    assert _traced(program, X, part)[1] == ["first", "second"], "forgotten with JAX's own"


def test_jax_frees_both_and_no_argument_outlives_its_call():
    x, part = X + 1, Part(jnp.asarray(2.0))
    program: Any = split_jit()
    program(x, part)
    given = weakref.ref(x)
    del x
    assert given() is None

    def compiled():
        return [half._executable._cache_size() for half in program._programs.values()]

    assert compiled() == [1, 1]
    jax.clear_caches()
    assert compiled() == [0, 0]


def test_a_later_process_traces_neither(files):
    part = Part(jnp.asarray(2.0))
    usual, traced = _traced(split_jit(), X, part)
    assert (traced, len(stored_files(files))) == (["first", "second"], 2)
    found, traced = _traced(split_jit(), X, part)
    same(found, usual)
    assert traced == []
    assert _traced(split_jit(), X, Part(jnp.asarray(2.0), power=jnp.cos))[1] == ["second"]
    # A function of a script has no name beyond this process.
    assert _traced(split_jit(), X, Part(jnp.asarray(2.0), power=lambda x: x))[1] == ["second"]
    assert len(stored_files(files)) == 3


def _says(x):
    jax.debug.callback(lambda: TRACES.append("ran"))
    return x + 1


def test_what_calls_python_runs_as_one_program(files):
    program, part = split_jit(), Part(jnp.asarray(2.0), power=_says)
    for _ in range(2):
        found, _ = _traced(program, X, part)
        jax.effects_barrier()
        np.testing.assert_allclose(found["a"], 2 * X + 1)
    assert TRACES[-1] == "ran"
    # Every half was traced by itself, the whole once.
    assert TRACES.count("second") == 2


def test_an_error_of_a_half_is_raised_and_the_other_half_is_kept():
    def wrong(x):
        raise ValueError("no such power")

    program = split_jit()
    with pytest.raises(ValueError, match="no such power"):
        program(X, Part(jnp.asarray(2.0), power=wrong))
    for _ in range(500):  # the other thread may still compile it
        if program._programs:
            break
        time.sleep(0.01)
    assert _traced(program, X, Part(jnp.asarray(2.0)))[1] == ["second"]


@pytest.mark.parametrize("wide", [True, False])
def test_settings_of_a_context_hold_for_both(wide):
    with jax.enable_x64(wide):
        x, part = jnp.linspace(-1.0, 1.0, 5), Part(jnp.asarray(2.0))
        found = split_jit()(x, part)
        same(found, eqx.filter_jit(chain)(x, part))
    assert found["a"].dtype == (jnp.float64 if wide else jnp.float32)


def test_arrays_that_were_put_somewhere_stay_there():
    x, part = jax.device_put(X, jax.devices()[0]), Part(jnp.asarray(2.0))
    same(split_jit()(x, part), eqx.filter_jit(chain)(x, part))


def test_within_a_transform_it_is_one_program(files):
    program, part = split_jit(), Part(jnp.asarray(2.0))
    slope = jax.jit(jax.grad(lambda x: program(x, part)["a"].sum()))(X)
    np.testing.assert_allclose(slope, 8 * X)
    mapped = jax.jit(jax.vmap(lambda x: program(x, part)["a"]))(X)
    np.testing.assert_allclose(mapped, 4 * X**2)
    assert not files.folder.exists()


def test_ahead_of_its_call():
    part = Part(jnp.asarray(2.0))
    program = split_jit().ahead(X, part)
    found, traced = _traced(program, X + 1, part)
    np.testing.assert_allclose(found["a"], 4 * (X + 1) ** 2)
    assert traced == []
    with pytest.raises(TypeError, match="`chain` was compiled for arguments of other shapes"):
        program(X[:3], part)
