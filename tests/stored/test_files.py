"""Files of programs are whole and private, or they are not read."""

import os
import pickle
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import pytest
from stored.programs import Part, X, run, same, stored_files

from mvedge_jax import _stored
from mvedge_jax._stored import ProgramFiles, _files


def _flipped(data):
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


def _linked(path, aside):
    path.rename(aside)
    path.symlink_to(aside)


def _a_pipe(path):
    path.unlink()
    os.mkfifo(path, 0o600)


def _sealed(path, content):
    """A file that is whole, of something else."""
    path.write_bytes(_files._sealed(pickle.dumps(content), path.stem))


SPOIL = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "corrupted": lambda path: path.write_bytes(_flipped(path.read_bytes())),
    "empty": lambda path: path.write_bytes(b""),
    "open to others": lambda path: path.chmod(0o640),
    "in an open folder": lambda path: path.parent.chmod(0o755),
    "linked": lambda path: _linked(path, path.with_suffix(".elsewhere")),
    "in a linked folder": lambda path: _linked(path.parent, path.parent.with_name("aside")),
    "another pickle": lambda path: _sealed(path, "no program"),
    "a pipe": _a_pipe,
}


@pytest.mark.parametrize("how", [*SPOIL, "of another program", "of another account"])
def test_a_file_in_doubt_is_ignored(files, how, monkeypatch):
    part = Part(jnp.asarray(2.0))
    wanted, _ = run(X, part)
    (path,) = stored_files(files)
    if how == "of another program":
        run(X[:3], part)
        (other,) = [other for other in stored_files(files) if other != path]
        other.replace(path)
    elif how == "of another account":
        own = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: own + 1)
    else:
        SPOIL[how](path)
    found, traces = run(X, part)
    assert traces == 1
    same(found, wanted)


class _Evil:
    """Makes a folder where it is unpickled."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


@pytest.mark.parametrize(("mode", "ran"), [(0o600, True), (0o644, False), (0o660, False)])
def test_nothing_that_others_may_have_written_is_unpickled(files, tmp_path, mode, ran):
    part = Part(jnp.asarray(2.0))
    run(X, part)
    (path,) = stored_files(files)
    _sealed(path, _Evil(tmp_path / "made"))
    path.chmod(mode)
    run(X, part)
    assert (tmp_path / "made").exists() == ran


def test_a_folder_that_cannot_be_written_is_no_error(files):
    files.folder.parent.joinpath("programs").write_text("a file")
    assert run(X, Part(jnp.asarray(2.0)))[1] == 1


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
    files = ProgramFiles(folder)
    for _ in range(100):
        if not files.write("key", letter * 100_000):
            return "not written"
        found = files.read("key")
        if found is None or found != found[:1] * 100_000:
            return f"half a file: {found and len(found)}"
    return None


def test_concurrent_writers_leave_whole_files(tmp_path):
    with ThreadPoolExecutor(3) as pool:
        found = pool.map(_write_and_read, 3 * [tmp_path / "programs"], (b"a", b"b", b"c"))
        assert list(found) == [None] * 3
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
