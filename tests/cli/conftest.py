"""A command line that is run in this process, and a light field that several commands share."""

import pytest
from cli.scenes import write_plane

from mvedge_jax.cli import main


@pytest.fixture
def mvedge(capsys, monkeypatch):
    """Runs a command line, looks at its exit code, gives what it says; complaints in one line."""
    monkeypatch.setenv("MVEDGE_CACHE", "off")

    def run(*words, code=0):
        capsys.readouterr()
        found = main([str(word) for word in words])
        said = capsys.readouterr()
        assert found == code, said.err
        assert "Traceback" not in said.err
        return said._replace(err=" ".join(said.err.split()))

    return run


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    return write_plane(tmp_path_factory.mktemp("scene") / "plane")
