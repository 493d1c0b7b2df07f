"""The entry point: which commands there are, and what a user's mistake looks like."""

import importlib
import os
import sys
import traceback
from collections.abc import Callable, Sequence

import tyro

from ._common import enable_compilation_cache

# Command -> module, function. Only the module of the command that runs is imported.
_COMMANDS = {
    "info": ("._info", "info"),
    "render": ("._render", "render"),
    "eval": ("._eval", "evaluate"),
    "edges": ("._edges", "edges"),
    "depth": ("._depth", "depth"),
    "views": ("._views", "views"),
    "stereo": ("._stereo", "stereo"),
    "edit": ("._edit", "edit"),
    "superpixels": ("._superpixels", "superpixels"),
    "optimize": ("._optimize", "optimize"),
    "batch": ("._batch", "batch"),
    "sweep": ("._sweep", "sweep"),
    "export": ("._export", "export"),
    "demo": ("._demo", "demo"),
}
_DESCRIPTION = (
    "Multi-view edges and dense, occlusion-correct depth from light fields.\n\n"
    "`mvedge COMMAND --help` explains a command. Options for all commands: --debug shows the "
    "traceback of an error; --no-cache does without JAX's persistent compilation cache."
)


def _load(name: str) -> Callable:
    module, function = _COMMANDS[name]
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
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    if "--no-cache" in words:
        words = [word for word in words if word != "--no-cache"]
        os.environ["MVEDGE_CACHE"] = "off"
    enable_compilation_cache()
    try:
        # A flag is --overwrite, without a --no-overwrite beside it.
        config = (tyro.conf.FlagCreatePairsOff,)
        if words and words[0] in _COMMANDS:
            command = _load(words[0])
            result = tyro.cli(command, prog=f"mvedge {words[0]}", args=words[1:], config=config)
        else:  # --help, or a mistake that the list of commands answers
            result = tyro.extras.subcommand_cli_from_dict(
                {name: _load(name) for name in _COMMANDS},
                prog="mvedge",
                description=_DESCRIPTION,
                args=words,
                config=config,
            )
    except SystemExit as stop:  # tyro's own answer to --help or a wrong option
        return stop.code if isinstance(stop.code, int) else 2
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; nothing was left half-written\n")
        return 130
    except (ValueError, OSError) as mistake:
        if debug:
            traceback.print_exc()
        sys.stderr.write(f"mvedge: error: {mistake}\n")
        return 2
    except Exception as fault:
        if debug:
            traceback.print_exc()
        sys.stderr.write(
            f"mvedge: internal error: {type(fault).__name__}: {fault} (--debug shows where)\n"
        )
        return 1
    return result if isinstance(result, int) else 0
