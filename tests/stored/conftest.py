"""A folder of programs in use."""

import pytest
from stored import programs

from mvedge_jax import _compiler
from mvedge_jax._stored import ProgramFiles, _key, _program


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder of programs in use, in which the functions of `programs` count as the package's."""
    files = ProgramFiles(tmp_path / "programs")
    monkeypatch.setattr(_compiler, "in_use", lambda: files)
    monkeypatch.setattr(_program, "_WORTH", 0.0)
    monkeypatch.setattr(_key, "_TRUSTED", _key._TRUSTED | {programs.__name__.partition(".")[0]})
    monkeypatch.setattr(_key, "_seen", {})
    programs.TRACES.clear()
    return files
