"""What the commands share: progress, messages, memory and the compilation cache."""

import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
from rich.console import Console

_PROGRESS = Console(stderr=True)


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """Shows `name` with a spinner while the body runs, and its time when it is done."""
    start = time.perf_counter()
    with _PROGRESS.status(name):
        yield
    _PROGRESS.print(f"[green]done[/] {name} ({time.perf_counter() - start:.1f} s)")


def note(text: str) -> None:
    """Prints a line for the user to the standard output."""
    sys.stdout.write(text + "\n")


def warn(text: str) -> None:
    """Prints a warning to the standard error."""
    _PROGRESS.print(f"[yellow]warning[/] {text}", highlight=False)


def compiled(function: Any, *arguments: Any) -> Callable[..., Any]:
    """Compiles an `equinox.filter_jit` function, and gives back the memory that it took.

    Args:
        function: to compile.
        arguments: what it will be called with.

    Returns:
        The program, to be called with the same arguments.
    """
    program = function.lower(*arguments).compile()
    release_memory()
    return program


def release_memory() -> None:
    """Returns freed memory to the system, where the C library would keep it (glibc).

    The compiler leaves almost a gigabyte behind after the whole chain, beside which the arrays of
    the first run would otherwise be put.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def enable_compilation_cache() -> Path | None:
    """Switches on JAX's persistent compilation cache in the user's cache folder.

    `MVEDGE_CACHE=off` (or `--no-cache`) turns it off; `MVEDGE_CACHE=<folder>` moves it. A
    cache that the user configured through JAX's own variables is left alone.

    Returns:
        The folder, or None if the cache is off or could not be made.
    """
    wish = os.environ.get("MVEDGE_CACHE", "")
    if wish.lower() in {"off", "0", "no"}:
        return None
    configured = jax.config.values.get("jax_compilation_cache_dir")
    if configured:
        return Path(configured)
    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mvedge_jax"
    folder = Path(wish) if wish else default / "jax"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
    return folder
