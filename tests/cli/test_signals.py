"""Signals that arrive while a result is being written."""

import signal
import subprocess
import sys
import time

import pytest

# A shell has what it runs in the background ignore some signals, and children inherit that.
_LISTEN = """
import signal, sys, time
for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(kind, signal.SIG_DFL)
from mvedge._run import listen
listen()
"""
_BUSY = """
from pathlib import Path
from mvedge_jax.cli._interruption import GUARD
from mvedge_jax.cli._output import output_folder

try:
    with output_folder(Path(sys.argv[1]), overwrite=True) as folder:
        (folder / "half.txt").write_text("half")
        print("inside", file=sys.stderr, flush=True)
        count = 0
        while True:
            count += 1
            (folder / f"{count}.txt").write_text("x")
except OSError as gone:  # the folder went away beneath it: told as `main` does, if there is time
    with GUARD:
        print(gone, file=sys.stderr)
"""
_EARLY = """
print("inside", file=sys.stderr, flush=True)
time.sleep(60)
"""
_UNREAD = """
from mvedge_jax.cli._common import note
print("inside", file=sys.stderr, flush=True)
note("x" * 10**6)
"""


def _interrupted(code, kind, *words, wait=0.0):
    """Sends a signal to a process that is inside; looks at how it ends."""
    with subprocess.Popen(
        [sys.executable, "-c", _LISTEN + code, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "inside\n"
        time.sleep(wait)
        process.send_signal(kind)
        try:
            assert process.wait(timeout=30) == 128 + kind
        finally:
            process.kill()
        assert process.stderr.read() == "interrupted; nothing was left half-written\n"


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_busy_process_and_leaves_nothing(tmp_path, kind):
    out = tmp_path / "out"
    if kind == signal.SIGTERM:
        out.mkdir()
    _interrupted(_BUSY, kind, out)
    assert list(tmp_path.iterdir()) == ([out] if kind == signal.SIGTERM else [])
    assert not out.exists() or not list(out.iterdir())


def test_a_signal_before_the_libraries_are_there():
    _interrupted(_EARLY, signal.SIGINT)


def test_a_signal_ends_what_waits_for_a_reader_that_never_reads():
    # The pipe is full by then, or is filled after the signal.
    _interrupted(_UNREAD, signal.SIGTERM, wait=0.5)
