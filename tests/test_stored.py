"""Programs come back from files as they were, or are compiled as usual."""

import functools
import multiprocessing
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mvedge_jax as mv
from mvedge_jax import _compiler, _stored, edit
from mvedge_jax._compiler import lean_jit
from mvedge_jax._stored import ProgramFiles, _files, _key, _program

_TRACES = []


class Part(eqx.Module):
    weight: Any
    power: Any = eqx.field(static=True, default=2)


class Found(eqx.Module):
    power: jax.Array
    name: str = eqx.field(static=True)
    nothing: None
    text: str


def powers(x, part, *, key=None):
    _TRACES.append("trace")
    noise = 0 if key is None else jax.random.normal(key, x.shape, x.dtype)
    power = x**part.power if isinstance(part.power, int) else part.power(x)
    return {"a": Found(part.weight * power + noise, "powers", None, "said"), "b": (x.sum(), 3)}


def told(x):
    jax.debug.callback(lambda: _TRACES.append("told"))
    return x + 1


def asked(x):
    return jax.pure_callback(lambda x: np.asarray(x) + 1, jax.ShapeDtypeStruct(x.shape, x.dtype), x)


def refused(x):
    return eqx.error_if(x, x < 0, "negative")


def listed(x, kinds):
    return x * len(kinds)


def _sum(x):
    return x.sum()


_CONSTANT = np.arange(3.0)


def with_constant(x):
    return x + jnp.asarray(_CONSTANT)


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder of programs in use, in which this module's functions count as the package's."""
    files = ProgramFiles(tmp_path / "programs")
    monkeypatch.setattr(_compiler, "in_use", lambda: files)
    monkeypatch.setattr(_program, "_WORTH", 0.0)
    monkeypatch.setattr(_key, "_TRUSTED", _key._TRUSTED | {__name__.partition(".")[0]})
    monkeypatch.setattr(_key, "_seen", {})
    _TRACES.clear()
    return files


def _stored_files(files):
    return sorted(files.folder.glob("*.program"))


def _run(*arguments, function=powers, **options):
    """A call as in a new process, and how often the function was traced."""
    before = len(_TRACES)
    result = jax.block_until_ready(lean_jit(function)(*arguments, **options))
    return result, len(_TRACES) - before


def _same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert type(x) is type(y)
        np.testing.assert_array_equal(x, y)
        for about in ("dtype", "weak_type", "committed", "sharding"):
            assert getattr(x, about, None) == getattr(y, about, None)


_X = jnp.linspace(-1.0, 1.0, 7)


@pytest.mark.parametrize("key", [None, jax.random.key(3)], ids=["no key", "key"])
@pytest.mark.parametrize("x", [_X, np.asarray(_X)], ids=["jax", "numpy"])
def test_a_later_process_traces_nothing(files, x, key):
    part = Part(jnp.asarray(2.0))
    usual = eqx.filter_jit(powers)(x, part, key=key)
    first, traces = _run(x, part, key=key)
    assert (traces, len(_stored_files(files))) == (1, 1)
    second, traces = _run(x, part, key=key)
    assert (traces, len(_stored_files(files))) == (0, 1)
    _same(first, usual)
    _same(second, usual)
    other = _run(x, Part(jnp.asarray(4.0)), key=None if key is None else jax.random.key(3))
    assert other[1] == 0
    assert jax.tree.structure(other[0]) == jax.tree.structure(usual)


def test_the_same_process_reads_it_once(files, monkeypatch):
    program = lean_jit(powers)
    part = Part(jnp.asarray(2.0))
    program(_X, part)
    monkeypatch.setattr(ProgramFiles, "read", None)
    program(_X + 1, Part(jnp.asarray(3.0)))
    assert len(_TRACES) == 1
    jax.clear_caches()
    monkeypatch.undo()
    program(_X, part)
    assert len(_TRACES) == 2, "what JAX was told to forget is forgotten here, too"


def _truncated(path):
    path.write_bytes(path.read_bytes()[:-100])


def _corrupted(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _empty(path):
    path.write_bytes(b"")


def _open_to_others(path):
    path.chmod(0o640)


def _in_an_open_folder(path):
    path.parent.chmod(0o755)


def _linked(path):
    path.rename(path.with_suffix(".elsewhere"))
    path.symlink_to(path.with_suffix(".elsewhere"))


def _in_a_linked_folder(path):
    aside = path.parent.with_name("aside")
    path.parent.rename(aside)
    path.parent.symlink_to(aside)


def _of_another_program(path):
    (other,) = [other for other in path.parent.glob("*.program") if other != path]
    path.write_bytes(other.read_bytes())


def _another_pickle(path):
    path.write_bytes(_files._sealed(pickle.dumps("no program"), path.stem))


def _a_pipe(path):
    path.unlink()
    os.mkfifo(path, 0o600)


@pytest.mark.parametrize(
    "spoil",
    [
        _truncated,
        _corrupted,
        _empty,
        _open_to_others,
        _in_an_open_folder,
        _linked,
        _in_a_linked_folder,
        _of_another_program,
        _another_pickle,
        _a_pipe,
    ],
)
def test_a_file_in_doubt_is_ignored(files, spoil):
    part = Part(jnp.asarray(2.0))
    wanted, _ = _run(_X, part)
    (path,) = _stored_files(files)
    _run(_X[:3], part)
    spoil(path)
    found, traces = _run(_X, part)
    assert traces == 1
    _same(found, wanted)


def test_another_accounts_file_is_ignored(files, monkeypatch):
    part = Part(jnp.asarray(2.0))
    _run(_X, part)
    own = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    assert _run(_X, part)[1] == 1


class _Evil:
    """Makes a folder where it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


@pytest.mark.parametrize(("mode", "ran"), [(0o600, True), (0o644, False), (0o660, False)])
def test_nothing_that_others_may_have_written_is_unpickled(files, tmp_path, mode, ran):
    part = Part(jnp.asarray(2.0))
    _run(_X, part)
    (path,) = _stored_files(files)
    path.write_bytes(_files._sealed(pickle.dumps(_Evil(tmp_path / "made")), path.stem))
    path.chmod(mode)
    _run(_X, part)
    assert (tmp_path / "made").exists() == ran


def test_what_a_program_depends_on_makes_another(files, monkeypatch):
    part = Part(jnp.asarray(2.0))
    _run(_X, part)
    weak = Part(jnp.asarray(2.0, jnp.float32) * 1.0)
    changes = [
        (_X[:3], part),
        (_X.astype(jnp.float32), weak),
        (_X, Part(jnp.asarray(2.0), power=3)),
        (_X, Part(jnp.asarray(2.0), power=True)),
        (_X, Part(jnp.asarray(2.0), power=jnp.cbrt)),
        (_X, Part(2.0)),
        (_X, Part(3.0)),
        (np.asarray(_X), part),
        (jax.device_put(_X, jax.devices()[0]), part),
    ]
    for x, changed in changes:
        assert _run(x, changed)[1] == 1
        assert _run(x, changed)[1] == 0
    with jax.default_matmul_precision("float32"):
        assert _run(_X, part)[1] == 1
    with jax.numpy_rank_promotion("allow"):
        assert _run(_X, part)[1] == 1
    monkeypatch.setattr(_key, "_hash_of", lambda root, paths: "another version of the sources")
    assert _run(_X, part)[1] == 1
    monkeypatch.undo()
    assert len(_stored_files(files)) == len(changes) + 4


def test_sources_that_were_changed_after_the_import_are_in_doubt(files, monkeypatch):
    monkeypatch.setattr(_key, "_IMPORTED", 0.0)
    _run(_X, Part(jnp.asarray(2.0)))
    assert not _stored_files(files)


def test_replaced_parts_of_the_package_are_in_doubt(files, monkeypatch):
    _key.program_key(powers, (_X,), {})
    for target, name in ((edit, "_SAME"), (edit, "_between"), (mv.EdgeDepth, "__call__")):
        with monkeypatch.context() as patch:
            patch.setattr(target, name, 0.2)
            with pytest.raises(_key.NoKey, match=rf"{name} was replaced"):
                _key.program_key(powers, (_X,), {})
        _key.program_key(powers, (_X,), {})


def test_surroundings_name_versions_and_the_processor():
    found = _key._surroundings()
    for part in (jax.__version__, np.__version__, sys.version, eqx.__version__):
        assert repr(part)[1:-1] in found
    assert "flags" in found or sys.platform != "linux"


class _Users(eqx.Module):
    weight: Any

    def __call__(self, x):
        return self.weight * x


_Users.__module__ = "users_own_module"


@pytest.mark.parametrize(
    "part",
    [
        Part(jnp.asarray(2.0), power=lambda x: x),
        Part(jnp.asarray(2.0), power=functools.partial(jnp.clip, min=0)),
        Part(jnp.asarray(2.0), power=os.path.join),
        Part(jnp.asarray(2.0), power=_Users(3.0)),
        Part(jnp.asarray(2.0), power=_Users(3.0).__call__),
        Part(jnp.asarray(2.0), power=type("Local", (), {"__call__": lambda self, x: x})()),
    ],
    ids=["lambda", "partial", "other library", "user's part", "method", "local class"],
)
def test_what_is_not_the_packages_is_never_stored(files, part):
    if part.power is os.path.join:
        part = Part(part.weight, power=(os.path.join,))
        lean_jit(listed)(_X, part.power)
    else:
        lean_jit(powers)(_X, part)
    assert not files.folder.exists()


def test_functions_that_are_not_the_packages_are_never_stored(files):
    def local(x):
        return x + 1

    for function in (lambda x: x + 1, local):
        lean_jit(function)(_X)
    # The names are the package's, what they do is not.
    lean_jit(jax.grad(_sum))(_X)
    users = eval("lambda x, part: x", {"__name__": "users_own_module"})
    changed = functools.wraps(powers)(users)
    np.testing.assert_array_equal(lean_jit(changed)(_X, Part(jnp.asarray(2.0))), _X)
    assert not files.folder.exists()


def test_programs_that_call_python_are_never_stored(files):
    np.testing.assert_array_equal(_run(_X, function=told)[0], _X + 1)
    jax.effects_barrier()
    assert _TRACES == ["told"]
    np.testing.assert_array_equal(_run(_X, function=asked)[0], _X + 1)
    assert not files.folder.exists()


def test_errors_of_a_program_are_raised(files):
    for _ in range(2):
        np.testing.assert_array_equal(_run(_X[-2:], function=refused)[0], _X[-2:])
        with pytest.raises(RuntimeError, match="negative"):
            _run(_X[:2], function=refused)
    assert not files.folder.exists()


@pytest.mark.parametrize("setting", ["jax_debug_nans", "jax_disable_jit", "jax_check_tracer_leaks"])
def test_who_diagnoses_meets_jax_alone(files, setting):
    before = jax.config.values[setting]
    jax.config.update(setting, True)
    try:
        _run(_X, Part(jnp.asarray(2.0)))
    finally:
        jax.config.update(setting, before)
    assert not files.folder.exists()


@pytest.mark.parametrize("setting", [jax.debug_nans, jax.disable_jit, jax.debug_infs])
def test_who_diagnoses_for_a_while_meets_jax_alone(files, setting):
    program, part = lean_jit(powers), Part(jnp.asarray(2.0))
    program(_X, part)
    (path,) = _stored_files(files)
    path.unlink()
    with setting(True):
        program(_X, part)
        with pytest.raises(_key.NoKey, match="diagnosing"):
            _key.program_key(powers, (_X,), {})
    assert not _stored_files(files)


def test_another_device_is_not_tried(files, monkeypatch):
    with jax.default_device(jax.devices()[0]):
        _run(_X, Part(jnp.asarray(2.0)))
    monkeypatch.setattr(_key.jax, "default_backend", lambda: "gpu")
    _run(_X, Part(jnp.asarray(2.0)))
    assert not files.folder.exists()


def test_within_a_transform_nothing_is_stored(files):
    program, part = lean_jit(powers), Part(jnp.asarray(2.0))
    jax.jit(lambda x: program(x, part)["b"][0])(_X)
    slope = jax.grad(lambda x: program(x, part)["b"][0])(_X)
    np.testing.assert_array_equal(slope, jnp.ones_like(_X))
    jax.vmap(lambda x: program(x, part)["b"][0])(_X[:, None])
    assert not files.folder.exists()


def test_a_program_with_constants_works(files):
    for _ in range(2):
        found, _ = _run(_X[:3], function=with_constant)
        np.testing.assert_array_equal(found, _X[:3] + _CONSTANT)


def test_a_program_ahead_of_its_call(files):
    part = Part(jnp.asarray(2.0))
    wanted, _ = _run(_X, part)
    program = lean_jit(powers).ahead(_X, part)
    _same(program(_X, part), wanted)
    assert len(_TRACES) == 1
    for other in ((_X[:3], part), (_X, Part(part.weight, power=3))):
        with pytest.raises(TypeError, match="`powers` was compiled for arguments of other shapes"):
            program(*other)


def test_a_folder_that_cannot_be_written_is_no_error(files, monkeypatch):
    files.folder.parent.joinpath("programs").write_text("a file")
    assert _run(_X, Part(jnp.asarray(2.0)))[1] == 1


def test_the_oldest_programs_make_room(tmp_path):
    files = ProgramFiles(tmp_path / "programs", limit=1000)
    assert all(files.write(f"key{i}", bytes(300)) for i in range(2))
    for i, name in enumerate(["key0", "key1"]):
        os.utime(files.folder / f"{name}.program", (i, i))
    assert files.read("key0") == bytes(300), "which makes it the one used last"
    abandoned = files.folder / "key.0.unfinished"
    abandoned.write_bytes(b"")
    os.utime(abandoned, (0, 0))
    assert files.write("key2", bytes(300))
    assert files.read("key1") is None
    assert files.read("key0") == files.read("key2") == bytes(300)
    assert not abandoned.exists()
    assert not files.write("large", bytes(1000))
    assert sorted(p.name for p in files.folder.iterdir()) == ["key0.program", "key2.program"]
    assert all(p.stat().st_mode & 0o777 == 0o600 for p in files.folder.iterdir())
    assert files.folder.stat().st_mode & 0o777 == 0o700


def _write_and_read(folder, letter):
    files = ProgramFiles(Path(folder))
    for _ in range(100):
        if not files.write("key", letter * 100_000):
            return "not written"
        found = files.read("key")
        if found is None or found != found[:1] * 100_000:
            return f"half a file: {found and len(found)}"
    return None


def test_concurrent_writers_leave_whole_files(tmp_path):
    with multiprocessing.get_context("forkserver").Pool(3) as pool:
        work = [(tmp_path / "programs", letter) for letter in (b"a", b"b", b"c")]
        assert pool.starmap(_write_and_read, work) == [None] * 3
    assert [p.name for p in (tmp_path / "programs").iterdir()] == ["key.program"]


def test_only_the_configured_cache_is_used(tmp_path, monkeypatch):
    monkeypatch.setattr(_files, "_in_use", [])
    assert _stored.in_use() is None
    files = ProgramFiles(tmp_path / "programs")
    _stored.use(files)
    values = dict(jax.config.values)
    monkeypatch.setattr(_files.jax, "config", type("Config", (), {"values": values}))
    assert _stored.in_use() is None, "JAX's cache is off"
    values["jax_compilation_cache_dir"] = str(tmp_path)
    assert _stored.in_use() == files
    values["jax_enable_compilation_cache"] = False
    assert _stored.in_use() is None
    values |= {"jax_compilation_cache_dir": "/elsewhere", "jax_enable_compilation_cache": True}
    assert _stored.in_use() is None


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
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=environment | {"MVEDGE_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout.split()


def test_a_second_process_reads_what_the_first_compiled(tmp_path):
    first, second, without = (
        _in_a_process(_PICTURE, cache) for cache in (tmp_path, tmp_path, "off")
    )
    assert (first[0], second[0], without[0]) == ("True", "False", "True")
    assert first[1:] == second[1:] == without[1:]
    (path,) = (tmp_path / "programs").iterdir()
    path.unlink()
    # Now JAX reads the program from its own cache, and such an executable has no second copy.
    assert _in_a_process(_PICTURE, tmp_path) == first
    assert not list((tmp_path / "programs").iterdir())


@pytest.mark.slow
def test_the_chain_has_the_same_bits_from_a_file(tmp_path):
    first, second, without = (_in_a_process(_CHAIN, cache) for cache in (tmp_path, tmp_path, "off"))
    assert (first[0], second[0], without[0]) == ("1", "0", "1")
    assert first[1] == second[1] == without[1]
