"""What a user of the command line meets: help, exit codes, the cache."""

import io
import json
import os
import subprocess
import sys
import warnings
from importlib.metadata import PackageNotFoundError
from types import SimpleNamespace

import pytest
from rich.console import Console

import mvedge_jax
from mvedge import _version
from mvedge_jax import _cache
from mvedge_jax.cli import _common, _main, _output


@pytest.fixture
def instead(monkeypatch):
    """Puts a function in the place of every command."""

    def put(function):
        def command():
            """Does what the test wants."""
            function()

        monkeypatch.setattr(_main, "_load", lambda name: command)

    return put


SHORT = "mvedge: error: the memory does not suffice: "
FAILURES = [
    (ValueError("`x` must be 1, got 2."), 2, "mvedge: error: `x` must be 1, got 2."),
    (FileNotFoundError("no such scene"), 2, "mvedge: error: no such scene"),
    (KeyboardInterrupt(), 130, "interrupted; nothing was left half-written"),
    (RuntimeError("broken"), 1, "mvedge: internal error: RuntimeError: broken (--debug shows"),
    (MemoryError("Unable to allocate 9.0 GiB"), 2, SHORT + "Unable to allocate 9.0 GiB"),
    (RuntimeError("RESOURCE_EXHAUSTED: 9 GiB"), 2, SHORT + "RESOURCE_EXHAUSTED: 9 GiB"),
]


@pytest.mark.parametrize(("error", "code", "text"), FAILURES)
def test_exit_codes(instead, mvedge, capsys, error, code, text):
    def fail():
        raise error

    instead(fail)
    said = mvedge("info", code=code).err
    assert said.startswith(text)
    assert ("--scale 0.5" in said) == (SHORT in text)
    assert _main.main(["info", "--debug"]) == code
    assert ("Traceback" in capsys.readouterr().err) == (code != 130)


def test_libraries_warn_in_one_line(instead, mvedge):
    instead(lambda: warnings.warn("something\nof two lines", UserWarning, stacklevel=1))
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert mvedge("info").err == "warning something\\nof two lines"


_LIGHT = """
import sys
from mvedge import run
code = run()
heavy = {"cv2", "jax", "mvedge_jax", "numpy"} & set(sys.modules)
assert not heavy, heavy
sys.exit(code)
"""


_WHOLE = "import sys; from mvedge_jax.cli import main; sys.exit(main())"


@pytest.mark.parametrize("words", [["--help"], []])
def test_the_overview_is_the_same_without_the_libraries(words):
    """`mvedge --help` reads docstrings from sources; the command line itself imports them."""
    environment = {**os.environ, "COLUMNS": "100", "MVEDGE_CACHE": "off"}
    runs = [
        subprocess.run([sys.executable, "-c", code, *words], capture_output=True, env=environment)
        for code in (_LIGHT, _WHOLE)
    ]
    light, whole = ((run.returncode, run.stdout, run.stderr) for run in runs)
    assert light == whole
    assert not words or all(command.encode() in light[1] for command in _main.COMMANDS)


def test_help_in_a_narrow_locale():
    """Through both modules that may be run; it explains presets and settings."""
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "COLUMNS": "200"}
    for module in ("mvedge", "mvedge_jax"):
        words = [sys.executable, "-m", module, "depth", "--help"]
        run = subprocess.run(words, capture_output=True, env=environment, check=True)
        said = run.stdout.decode("ascii")
        wanted = [
            "--overwrite",
            "--preset {full,learned,edges,thesis}",
            "--set PATH=VALUE",
            "--seed",
        ]
        for text in (*wanted, "smoothness.color=.3"):
            assert text in said


@pytest.mark.parametrize(
    ("variables", "configured", "expected"),
    [
        ({"MVEDGE_CACHE": "off"}, None, None),
        ({"MVEDGE_CACHE": "{tmp}/here"}, None, "{tmp}/here"),
        ({"XDG_CACHE_HOME": "{tmp}/xdg"}, None, "{tmp}/xdg/mvedge_jax/jax"),
        ({}, "{tmp}/own", "{tmp}/own"),
        ({"MVEDGE_CACHE": "{tmp}/file/folder"}, None, None),
    ],
)
def test_cache_goes_where_the_user_says(tmp_path, monkeypatch, variables, configured, expected):
    (tmp_path / "file").touch()
    asked, place = {}, lambda text: text and text.format(tmp=tmp_path)
    for name in ("MVEDGE_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, place(variables.get(name, "")))
    values = {"jax_compilation_cache_dir": place(configured)}
    config = SimpleNamespace(values=values, update=asked.__setitem__)
    monkeypatch.setattr(_cache.jax, "config", config)
    monkeypatch.setattr(_cache, "replaced_name", lambda: None)
    monkeypatch.setattr(_cache, "use", lambda files: asked.update(files=files.folder))
    found = mvedge_jax.compilation_cache()
    assert (found and str(found)) == place(expected)
    if configured or expected is None:
        assert asked == {}
    else:
        assert asked["jax_compilation_cache_dir"] == str(found)
        assert str(asked["files"]) == f"{place(expected)}/programs"


def test_versions(monkeypatch, mvedge, tmp_path):
    assert mvedge("--version").out == f"mvedge {mvedge_jax.__version__}\n"
    with pytest.raises(AttributeError, match="has no attribute 'ploting'"):
        _ = mvedge_jax.ploting

    def missing(name):  # sources run without an installation
        raise PackageNotFoundError(name)

    monkeypatch.setattr(_version, "version", missing)
    assert mvedge_jax.__version__ == "unknown (not installed)"
    assert mvedge("--version").out == "mvedge unknown (not installed)\n"
    with _output.output_folder(tmp_path / "out", inputs=[]):
        pass
    record = json.loads((tmp_path / "out" / _output.MARKER).read_text())
    assert record["version"] == "unknown (not installed)"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_stage_tells_a_terminal_how_long_it_has_taken(monkeypatch, terminal):
    said, now = io.StringIO(), iter([0.0, *([12.4] * 1000)])
    monkeypatch.setattr(_common.time, "perf_counter", lambda: next(now))
    console = Console(file=said, force_terminal=terminal, width=80, color_system=None)
    monkeypatch.setattr(_common, "_PROGRESS", console)
    with _common.stage("compiling depth"):
        pass
    assert ("compiling depth (12 s)" in said.getvalue()) == terminal
    assert "done compiling depth (12.4 s)" in said.getvalue()
