"""Programs come back from files as they were, or are compiled as usual."""

import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored import programs
from stored.programs import (
    TRACES,
    Part,
    X,
    asked,
    powers,
    refused,
    run,
    same,
    stored_files,
    told,
    with_constant,
)

from mvedge_jax._compiler import lean_jit
from mvedge_jax._stored import ProgramFiles


@pytest.mark.parametrize("key", [None, jax.random.key(3)], ids=["no key", "key"])
@pytest.mark.parametrize("x", [X, np.asarray(X)], ids=["jax", "numpy"])
def test_a_later_process_traces_nothing(files, x, key):
    part = Part(jnp.asarray(2.0))
    usual = eqx.filter_jit(powers)(x, part, key=key)
    for wanted in (1, 0):
        found, traces = run(x, part, key=key)
        assert (traces, len(stored_files(files))) == (wanted, 1)
        same(found, usual)
    other, traces = run(x, Part(jnp.asarray(4.0)), key=key)
    assert traces == 0
    assert jax.tree.structure(other) == jax.tree.structure(usual)


def test_the_same_process_reads_it_once(files, monkeypatch):
    program = lean_jit(powers)
    part = Part(jnp.asarray(2.0))
    program(X, part)
    monkeypatch.setattr(ProgramFiles, "read", None)
    program(X + 1, Part(jnp.asarray(3.0)))
    assert len(TRACES) == 1
    jax.clear_caches()
    monkeypatch.undo()
    program(X, part)
    assert len(TRACES) == 2, "what JAX was told to forget is forgotten here, too"


def test_programs_that_call_python_are_never_stored(files):
    np.testing.assert_array_equal(run(X, function=told)[0], X + 1)
    jax.effects_barrier()
    assert TRACES == ["told"]
    np.testing.assert_array_equal(run(X, function=asked)[0], X + 1)
    for _ in range(2):  # nor those that raise errors
        np.testing.assert_array_equal(run(X[-2:], function=refused)[0], X[-2:])
        with pytest.raises(RuntimeError, match="negative"):
            run(X[:2], function=refused)
    assert not files.folder.exists()


def test_within_a_transform_nothing_is_stored(files):
    program, part = lean_jit(powers), Part(jnp.asarray(2.0))
    jax.jit(lambda x: program(x, part)["b"][0])(X)
    slope = jax.grad(lambda x: program(x, part)["b"][0])(X)
    np.testing.assert_array_equal(slope, jnp.ones_like(X))
    jax.vmap(lambda x: program(x, part)["b"][0])(X[:, None])
    assert not files.folder.exists()


def test_a_program_with_constants_works(files):
    for _ in range(2):
        found, _ = run(X[:3], function=with_constant)
        np.testing.assert_array_equal(found, X[:3] + programs.CONSTANT)


def test_a_program_ahead_of_its_call(files):
    part = Part(jnp.asarray(2.0))
    wanted, _ = run(X, part)
    program = lean_jit(powers).ahead(X, part)
    same(program(X, part), wanted)
    assert len(TRACES) == 1
    for other in ((X[:3], part), (X, Part(part.weight, power=3))):
        with pytest.raises(TypeError, match="`powers` was compiled for arguments of other shapes"):
            program(*other)


_PICTURE = """
import jax, jax.numpy as jnp
import mvedge_jax as mv
from mvedge_jax import edit
from mvedge_jax._stored import _program
_program._WORTH = 0.0
traced = []
between = edit._between
edit._between = lambda *a, **o: (traced.append(1), between(*a, **o))[1]
mv.compilation_cache()
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
field = mv.LightField(jnp.zeros((3, 3, 9, 9, 3)), name="name")
edited = edit.insert_picture(field, jnp.zeros((3, 3, 9, 9)), jnp.ones((3, 3, 4)), at=(4.0, 4.0),
    disparity=1.0)
print(bool(traced), float(edited.views.sum()), edited.name)
"""
_CHAIN = """
import hashlib, sys, numpy as np, jax, jax.numpy as jnp
import mvedge_jax as mv
from mvedge_jax.depth import estimate_depth
mv.compilation_cache()
views = jnp.asarray(np.random.default_rng(0).random((3, 3, 16, 16, 3)), jnp.float32)
field = mv.LightField(views, disparity_range=(-1.0, 1.0))
model = mv.EdgeDepth.for_light_field(field)
result = model(field)
bits = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(result))
print(estimate_depth.traces, hashlib.sha256(bits).hexdigest())
"""


def _in_a_process(code, cache):
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {"MVEDGE_CACHE": str(cache), "JAX_ENABLE_X64": "1"}
    words = [sys.executable, "-c", code]
    run = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    return run.stdout.split()


def test_a_second_process_reads_what_the_first_compiled(tmp_path):
    first, second = (_in_a_process(_PICTURE, tmp_path) for _ in range(2))
    assert (first[0], second[0]) == ("True", "False")
    white = 9 * 3 * 3 * 3.0  # pixels of the picture in nine views
    assert first[1:] == second[1:] == [str(white), "name"]
    (path,) = (tmp_path / "programs").iterdir()
    path.unlink()
    # Now JAX reads the program from its own cache, and such an executable has no second copy.
    assert _in_a_process(_PICTURE, tmp_path) == first
    assert not list((tmp_path / "programs").iterdir())


@pytest.mark.slow
def test_the_chain_has_the_same_bits_from_a_file(tmp_path):
    first, second, without = (_in_a_process(_CHAIN, cache) for cache in (tmp_path, tmp_path, "off"))
    assert (first[0], second[0], without[0]) == ("2", "0", "2")
    assert first[1] == second[1] == without[1]
