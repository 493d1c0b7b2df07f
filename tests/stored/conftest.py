"""A folder of programs in use."""

import jax
import pytest
from jax.experimental.compilation_cache import compilation_cache
from stored import programs

from mvedge_jax import _compiler, _split_jit
from mvedge_jax._stored import ProgramFiles, _key, _program


@pytest.fixture(autouse=True)
def _without_the_cache_of_jax():
    """Programs that JAX reads from its own cache have no second copy."""
    folder = jax.config.values["jax_compilation_cache_dir"]
    _keep_in(None)
    yield
    _keep_in(folder)


def _keep_in(folder):
    jax.config.update("jax_compilation_cache_dir", folder)
    compilation_cache.reset_cache()


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder of programs in use, in which the functions of `programs` count as the package's."""
    files = ProgramFiles(tmp_path / "programs")
    for module in (_compiler, _split_jit):
        monkeypatch.setattr(module, "in_use", lambda: files)
    monkeypatch.setattr(_program, "_WORTH", 0.0)
    monkeypatch.setattr(_key, "_TRUSTED", _key._TRUSTED | {programs.__name__.partition(".")[0]})
    monkeypatch.setattr(_key, "_seen", {})
    programs.TRACES.clear()
    return files
