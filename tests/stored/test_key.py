"""Programs are told apart by all they depend on, or they are not kept."""

import functools
import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored.programs import Part, X, listed, powers, run, stored_files, summed

import mvedge_jax as mv
from mvedge_jax import edit
from mvedge_jax._compiler import lean_jit
from mvedge_jax._stored import _key


def test_what_a_program_depends_on_makes_another(files, monkeypatch):
    part = Part(jnp.asarray(2.0))
    run(X, part)
    weak = Part(jnp.asarray(2.0, jnp.float32) * 1.0)
    changes = [
        (X[:3], part),
        (X.astype(jnp.float32), weak),
        (X, Part(jnp.asarray(2.0), power=3)),
        (X, Part(jnp.asarray(2.0), power=True)),
        (X, Part(jnp.asarray(2.0), power=jnp.cbrt)),
        (X, Part(2.0)),
        (X, Part(3.0)),
        (np.asarray(X), part),
        (jax.device_put(X, jax.devices()[0]), part),
    ]
    for x, changed in changes:
        assert run(x, changed)[1] == 1
        assert run(x, changed)[1] == 0
    with jax.default_matmul_precision("float32"):
        assert run(X, part)[1] == 1
    with jax.numpy_rank_promotion("allow"):
        assert run(X, part)[1] == 1
    monkeypatch.setattr(_key, "_hash_of", lambda root, paths: "another version of the sources")
    assert run(X, part)[1] == 1
    monkeypatch.undo()
    assert len(stored_files(files)) == len(changes) + 4


def test_sources_that_were_changed_after_the_import_are_in_doubt(files, monkeypatch):
    monkeypatch.setattr(_key, "_IMPORTED", 0.0)
    run(X, Part(jnp.asarray(2.0)))
    assert not stored_files(files)


def test_replaced_parts_of_the_package_are_in_doubt(files, monkeypatch):
    _key.program_key(powers, (X,), {})
    for target, name in ((edit, "_SAME"), (edit, "_between"), (mv.EdgeDepth, "__call__")):
        with monkeypatch.context() as patch:
            patch.setattr(target, name, 0.2)
            with pytest.raises(_key.NoKey, match=rf"{name} was replaced"):
                _key.program_key(powers, (X,), {})
        _key.program_key(powers, (X,), {})


class _Users(eqx.Module):
    weight: Any

    def __call__(self, x):
        return self.weight * x


_Users.__module__ = "users_own_module"


OTHERS = {
    "lambda": lambda x: x,
    "partial": functools.partial(jnp.clip, min=0),
    "user's part": _Users(3.0),
    "method": _Users(3.0).__call__,
    "local class": type("Local", (), {"__call__": lambda self, x: x})(),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_what_is_not_the_packages_is_never_stored(files, kind):
    lean_jit(powers)(X, Part(jnp.asarray(2.0), power=OTHERS[kind]))
    assert not files.folder.exists()


def test_functions_that_are_not_the_packages_are_never_stored(files):
    def local(x):
        return x + 1

    for function in (lambda x: x + 1, local):
        lean_jit(function)(X)
    lean_jit(listed)(X, (os.path.join,))  # of another library
    # The names are the package's, what they do is not.
    lean_jit(jax.grad(summed))(X)
    users = eval("lambda x, part: x", {"__name__": "users_own_module"})
    changed = functools.wraps(powers)(users)
    np.testing.assert_array_equal(lean_jit(changed)(X, Part(jnp.asarray(2.0))), X)
    assert not files.folder.exists()


@pytest.mark.parametrize(
    "setting", [jax.debug_nans, jax.disable_jit, jax.debug_infs, jax.check_tracer_leaks]
)
def test_who_diagnoses_meets_jax_alone(files, setting):
    program, part = lean_jit(powers), Part(jnp.asarray(2.0))
    program(X, part)
    (path,) = stored_files(files)
    path.unlink()
    with setting(True):
        program(X, part)
        run(X, part)
        with pytest.raises(_key.NoKey, match="diagnosing"):
            _key.program_key(powers, (X,), {})
    assert not stored_files(files)


def test_another_device_is_not_tried(files, monkeypatch):
    with jax.default_device(jax.devices()[0]):
        run(X, Part(jnp.asarray(2.0)))
    monkeypatch.setattr(_key.jax, "default_backend", lambda: "gpu")
    run(X, Part(jnp.asarray(2.0)))
    assert not files.folder.exists()
