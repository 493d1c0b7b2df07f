"""What a user of the command line meets: help, exit codes, the cache."""

import io
import json
import os
import subprocess
import sys
import warnings
from importlib.metadata import PackageNotFoundError

import pytest
from rich.console import Console

import mvedge_jax
from mvedge import _version
from mvedge_jax.cli import _common, _main, _output


def _fail_with(error):
    def command():
        """Fails."""
        raise error

    return lambda name: command


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (ValueError("`x` must be 1, got 2."), 2, "`x` must be 1, got 2."),
        (FileNotFoundError("no such scene"), 2, "no such scene"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (RuntimeError("broken"), 1, "internal error: RuntimeError: broken"),
    ],
)
def test_exit_codes(monkeypatch, capsys, error, code, text):
    monkeypatch.setattr(_main, "_load", _fail_with(error))
    monkeypatch.setenv("MVEDGE_CACHE", "off")
    assert _main.main(["info"]) == code
    captured = capsys.readouterr()
    assert text in captured.err
    assert "Traceback" not in captured.err


def test_debug_shows_the_traceback(monkeypatch, capsys):
    monkeypatch.setattr(_main, "_load", _fail_with(ValueError("no")))
    monkeypatch.setenv("MVEDGE_CACHE", "off")
    assert _main.main(["info", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


_LIGHT = """
import sys
from mvedge import run
code = run()
heavy = {"cv2", "jax", "mvedge_jax", "numpy"} & set(sys.modules)
assert not heavy, heavy
sys.exit(code)
"""
_WHOLE = "import sys; from mvedge_jax.cli import main; sys.exit(main())"


@pytest.mark.parametrize("words", [["--help"], ["--version"], []])
def test_the_overview_is_the_same_without_the_libraries(words):
    """`mvedge --help` reads docstrings from sources; the command line itself imports them."""
    environment = {**os.environ, "COLUMNS": "100", "MVEDGE_CACHE": "off"}
    light, whole = (
        subprocess.run(
            [sys.executable, "-c", code, *words],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )
        for code in (_LIGHT, _WHOLE)
    )
    assert (light.returncode, light.stdout, light.stderr) == (
        whole.returncode,
        whole.stdout,
        whole.stderr,
    )
    assert words != ["--help"] or all(command in light.stdout for command in _main.COMMANDS)


def test_help_names_every_command():
    environment = {**os.environ, "MVEDGE_CACHE": "off"}
    run = subprocess.run(
        [sys.executable, "-m", "mvedge_jax", "--help"],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    for command in _main.COMMANDS:
        assert command in run.stdout


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"MVEDGE_CACHE": "off"}, "None"),
        ({"MVEDGE_CACHE": "{tmp}/here"}, "{tmp}/here"),
        ({"XDG_CACHE_HOME": "{tmp}/xdg"}, "{tmp}/xdg/mvedge_jax/jax"),
        ({"JAX_COMPILATION_CACHE_DIR": "{tmp}/own"}, "{tmp}/own"),
    ],
)
def test_cache_goes_where_the_user_says(tmp_path, variables, expected):
    clean = {
        k: v
        for k, v in os.environ.items()
        if k not in {"MVEDGE_CACHE", "XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"}
    }
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "import jax; from mvedge_jax import compilation_cache as f;"
            "print(f()); print(jax.config.values['jax_compilation_cache_dir'])",
        ],
        env={**clean, **{k: v.format(tmp=tmp_path) for k, v in variables.items()}},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.split() == [expected.format(tmp=tmp_path)] * 2


def test_versions(capsys):
    assert _main.main(["--version"]) == 0
    assert capsys.readouterr().out == f"mvedge {mvedge_jax.__version__}\n"
    assert mvedge_jax.plotting.plot_edges.__module__.startswith("mvedge_jax.plotting")
    with pytest.raises(AttributeError, match="has no attribute 'ploting'"):
        _ = mvedge_jax.ploting


def test_sources_run_without_an_installation(monkeypatch, capsys, tmp_path):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(_version, "version", missing)
    assert mvedge_jax.__version__ == "unknown (not installed)"
    assert _main.main(["--version"]) == 0
    assert capsys.readouterr().out == "mvedge unknown (not installed)\n"
    with _output.output_folder(tmp_path / "out", inputs=[]):
        pass
    record = json.loads((tmp_path / "out" / _output.MARKER).read_text())
    assert record["version"] == "unknown (not installed)"


def test_a_stage_tells_a_terminal_how_long_it_has_taken(monkeypatch):
    said, now = io.StringIO(), iter([0.0, *([12.4] * 1000)])
    monkeypatch.setattr(_common.time, "perf_counter", lambda: next(now))
    for terminal in (True, False):
        console = Console(file=said, force_terminal=terminal, width=80, color_system=None)
        monkeypatch.setattr(_common, "_PROGRESS", console)
        now = iter([0.0, *([12.4] * 1000)])
        with _common.stage("compiling depth"):
            pass
        found = said.getvalue()
        assert ("compiling depth (12 s)" in found) == terminal
        assert "done compiling depth (12.4 s)" in found
        said.seek(0)
        said.truncate()


def test_libraries_warn_in_one_line(monkeypatch, capsys):
    def command():
        """Warns."""
        warnings.warn("something\nof two lines", UserWarning, stacklevel=1)

    monkeypatch.setattr(_main, "_load", lambda name: command)
    monkeypatch.setenv("MVEDGE_CACHE", "off")
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert _main.main(["info"]) == 0
    assert capsys.readouterr().err == "warning something\\nof two lines\n"


@pytest.mark.parametrize(
    "error", [MemoryError("Unable to allocate 9.0 GiB"), RuntimeError("RESOURCE_EXHAUSTED: 9 GiB")]
)
def test_memory_that_does_not_suffice(monkeypatch, capsys, error):
    monkeypatch.setattr(_main, "_load", _fail_with(error))
    monkeypatch.setenv("MVEDGE_CACHE", "off")
    assert _main.main(["info"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "the memory does not suffice: " in line
    assert "9" in line
    assert "--scale 0.5" in line


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_help_in_any_locale(encoding):
    environment = {**os.environ, "MVEDGE_CACHE": "off", "PYTHONIOENCODING": encoding}
    run = subprocess.run(
        [sys.executable, "-m", "mvedge", "depth", "--help"],
        capture_output=True,
        env=environment,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert "--overwrite" in run.stdout.decode(encoding)
