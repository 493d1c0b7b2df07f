"""What an interruption has to remove, and what it must not cut in two."""

import contextlib
import os
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import jax

# Held by whoever puts a result in its place or prints; taken for good by `clean`, after which the
# main thread, whose folder is gone, can say nothing about it.
GUARD = threading.RLock()
# Process-wide, as signals are.
_unfinished: set[Path] = set()
# An entry of the compilation cache that was touched within so many seconds may be half-written.
_FRESH = 3.0
# Seconds to wait for the guard. Who holds it for longer writes into a pipe that nobody reads; were
# it a result on a slow disk, the next run into the same place would put it right.
_HELD = 5.0


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[None]:
    """Has `path`, a file or a folder, removed if the process is interrupted in the body."""
    _unfinished.add(path)
    try:
        yield
    finally:
        _unfinished.discard(path)


def clean() -> None:
    """Removes what is unfinished; the process must end after it. Called by the signals' thread."""
    GUARD.acquire(timeout=_HELD)
    for path in list(_unfinished):
        # The main thread may still be writing into a folder, faster than it can be emptied: by
        # another name it gets no new files.
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
