"""Cleanup after an interruption, and guards of operations that must be atomic."""

import contextlib
import os
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import jax

# Held while a result is moved into place or printed. `clean` takes it for good, so that the main
# thread, whose folder is gone, cannot print about it.
GUARD = threading.RLock()
# Process-wide, as signals are.
_unfinished: set[Path] = set()
# An entry of the compilation cache modified within this many seconds may be half-written.
_FRESH = 3.0
# Seconds to wait for the guard. A longer holder writes into an unread pipe; if it were a result on
# a slow disk, the next run with the same OUT would repair it.
_HELD = 5.0


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """Removes `path`, a file or a folder, if the process is interrupted in the body."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


def clean() -> None:
    """Removes unfinished output; the process must end after it. Called by the signals' thread."""
    GUARD.acquire(timeout=_HELD)
    for path in list(_unfinished):
        # Renamed first, because the main thread may still write into the folder.
        aside = path.with_name(f"{path.name}.removed")
        for _ in range(100):
            with contextlib.suppress(OSError):
                path.rename(aside)
            if aside.is_dir():
                shutil.rmtree(aside, ignore_errors=True)
            else:
                aside.unlink(missing_ok=True)
            if not (os.path.lexists(path) or os.path.lexists(aside)):
                break
            time.sleep(0.02)
    _drop_half_written_programs()
    if sys.stderr is not None and sys.stderr.isatty():  # a spinner hides the cursor
        os.write(2, b"\r\x1b[2K\x1b[?25h")


def _drop_half_written_programs() -> None:
    folder = jax.config.values.get("jax_compilation_cache_dir")
    if not folder:
        return
    with contextlib.suppress(OSError):
        for entry in Path(folder).glob("*-cache"):
            with contextlib.suppress(OSError):
                if time.time() - entry.stat().st_mtime < _FRESH:
                    entry.unlink()
