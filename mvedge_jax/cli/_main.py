"""The entry point: runs a command and turns errors into messages and exit codes."""

import contextlib
import importlib
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import tyro

from mvedge._help import COMMANDS, list_commands, tolerate_locales
from mvedge._version import package_version
from mvedge_jax._cache import compilation_cache

from ._common import note, printable, warn
from ._interruption import GUARD


def _load(name: str) -> Callable:
    module, function = COMMANDS[name]
    return getattr(importlib.import_module(module, __package__), function)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs `mvedge`.

    Args:
        arguments: the command line without the program's name; `sys.argv` by default.

    Returns:
        The exit code: 0 success, 1 a fault of the program, 2 a mistake in the command line or the
        files that it names, 130 interrupted.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    tolerate_locales()
    if words == ["--version"]:
        note(f"mvedge {package_version()}")
        return 0
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    if "--no-cache" in words:
        words = [word for word in words if word != "--no-cache"]
        os.environ["MVEDGE_CACHE"] = "off"
    if "--max-gb" in words[:-1]:
        place = words.index("--max-gb")
        os.environ["MVEDGE_MAX_GB"] = words[place + 1]
        del words[place : place + 2]
    logging: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 5, 4
    logging.setLogLevel(0)  # its messages are replaced by ours
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            # Missing glyphs in a title need no warning.
            warnings.filterwarnings("ignore", "Glyph .* missing from")
            compilation_cache()
            return _run(words)
    except SystemExit as stop:  # tyro's own answer to --help or a wrong option
        return stop.code if isinstance(stop.code, int) else 2
    except KeyboardInterrupt:
        return _fail("interrupted; nothing was left half-written", 130, debug=False)
    except MemoryError as shortage:
        return _fail(f"mvedge: error: {_short_of_memory(shortage)}", 2, debug=debug)
    except (ValueError, OSError) as mistake:
        return _fail(f"mvedge: error: {mistake}", 2, debug=debug)
    except Exception as fault:
        if "RESOURCE_EXHAUSTED" in str(fault):
            return _fail(f"mvedge: error: {_short_of_memory(fault)}", 2, debug=debug)
        reason = f"{type(fault).__name__}: {fault} (--debug shows where)"
        return _fail(f"mvedge: internal error: {reason}", 1, debug=debug)


def _run(words: list[str]) -> int:
    if words and words[0] in COMMANDS:
        command = _load(words[0])
        # A flag is --overwrite, without a --no-overwrite beside it.
        config = (tyro.conf.FlagCreatePairsOff,)
        result = tyro.cli(command, prog=f"mvedge {words[0]}", args=words[1:], config=config)
    else:  # --help, or a mistake that the list of commands answers
        result = list_commands(words, {name: _load(name) for name in COMMANDS})
    return result if isinstance(result, int) else 0


def _fail(message: str, code: int, *, debug: bool) -> int:
    with GUARD, contextlib.suppress(OSError):
        if debug:
            traceback.print_exc()
        sys.stderr.write(printable(message) + "\n")
    return code


def _short_of_memory(shortage: BaseException) -> str:
    need = str(shortage).rstrip(".") or "an array found no room"
    return (
        f"the memory does not suffice: {need}. Smaller or fewer views need less: --scale 0.5 needs "
        "a quarter, --views 5 a third to a half; `mvedge depth --memory GB` works in tiles; or end "
        "other programs."
    )


def _show_warning(message: Any, category: type[Warning], *_: Any, **__: Any) -> None:
    """Prints warnings of libraries in one line, without their source location."""
    if not issubclass(category, DeprecationWarning | PendingDeprecationWarning):
        warn(printable(str(message)))
