"""The commands there are, and `mvedge --help`, which needs no command's own libraries."""

import ast
import contextlib
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ._version import package_version

# Command -> module of `mvedge_jax.cli`, function.
COMMANDS = {
    "info": ("._info", "info"),
    "render": ("._render", "render"),
    "eval": ("._eval", "evaluate"),
    "edges": ("._edges", "edges"),
    "depth": ("._depth", "depth"),
    "view": ("._view", "view"),
    "views": ("._views", "views"),
    "stereo": ("._stereo", "stereo"),
    "edit": ("._edit", "edit"),
    "superpixels": ("._superpixels", "superpixels"),
    "optimize": ("._optimize", "optimize"),
    "batch": ("._batch", "batch"),
    "sweep": ("._sweep", "sweep"),
    "learn": ("._learn", "learn"),
    "export": ("._export", "export"),
    "demo": ("._demo", "demo"),
}
_DESCRIPTION = (
    "Multi-view edges and dense, occlusion-correct depth from light fields.\n\n"
    "`mvedge COMMAND --help` explains a command. Options for all commands: --debug shows the "
    "traceback of an error; --no-cache does without JAX's persistent compilation cache; "
    "--max-gb N lifts the limit of 8 GB that a light field may take; --version tells the version."
)


def answer(words: Sequence[str]) -> int | None:
    """Answers `--help`, `--version` and an empty command line, without importing JAX.

    Args:
        words: the command line without the program's name.

    Returns:
        The exit code, or None for any other command line.
    """
    words = list(words)
    if words not in ([], ["-h"], ["--help"], ["--version"]):
        return None
    tolerate_locales()
    with contextlib.suppress(OSError):  # nobody listens
        if words == ["--version"]:
            sys.stdout.write(f"mvedge {package_version()}\n")
            sys.stdout.flush()
            return 0
        try:
            list_commands(words, {name: _described(name) for name in COMMANDS})
        except SystemExit as stop:
            return stop.code if isinstance(stop.code, int) else 2
    return 0


def tolerate_locales() -> None:
    """Has the streams show the code of a letter that the locale lacks."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore


def list_commands(words: list[str], commands: dict[str, Callable[..., Any]]) -> Any:
    """Runs tyro over all commands: for `--help`, or a mistake that their list answers.

    Args:
        words: the command line.
        commands: by name.

    Returns:
        What the command returned.
    """
    import tyro

    return tyro.extras.subcommand_cli_from_dict(
        commands,
        prog="mvedge",
        description=_DESCRIPTION,
        args=words,
        # A flag is --overwrite, without a --no-overwrite beside it.
        config=(tyro.conf.FlagCreatePairsOff,),
    )


def _described(name: str) -> Callable[[], None]:
    """A function with the docstring of a command, read from its source."""
    module, function = COMMANDS[name]
    package = find_spec("mvedge_jax")
    assert package is not None
    assert package.origin is not None
    path = Path(package.origin).parent / "cli" / f"{module[1:]}.py"
    body = ast.parse(path.read_text(encoding="utf-8")).body
    (node,) = (n for n in body if isinstance(n, ast.FunctionDef) and n.name == function)

    def described() -> None: ...

    described.__doc__ = ast.get_docstring(node)
    return described
