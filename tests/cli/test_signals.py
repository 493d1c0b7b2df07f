"""Signals that arrive while a result is being written."""

import signal
import subprocess
import sys
import time

# A shell has what it runs in the background ignore some signals, and children inherit that.
_HEARD = """
import signal
for kind in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(kind, signal.SIG_DFL)
"""
_BUSY = """
import sys
from mvedge._run import listen

listen()
from pathlib import Path
from mvedge_jax.cli._interruption import GUARD
from mvedge_jax.cli._output import output_folder

try:
    with output_folder(Path(sys.argv[1]), overwrite=True) as folder:
        (folder / "half.txt").write_text("half")
        print("inside", flush=True)
        count = 0
        while True:
            count += 1
            (folder / f"{count}.txt").write_text("x")
except OSError as gone:  # the folder went away beneath it: told as `main` does, if there is time
    with GUARD:
        print(gone, file=sys.stderr)
"""


def test_a_signal_ends_a_busy_process_and_leaves_nothing(tmp_path):
    earlier = tmp_path / "SIGTERM"
    earlier.mkdir()
    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    running = [
        subprocess.Popen(
            [sys.executable, "-c", _HEARD + _BUSY, str(tmp_path / kind.name)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for kind in kinds
    ]
    for kind, process in zip(kinds, running, strict=True):
        assert process.stdout is not None
        assert process.stdout.readline() == "inside\n"
        process.send_signal(kind)
    for kind, process in zip(kinds, running, strict=True):
        _, text = process.communicate(timeout=30)
        assert process.returncode == 128 + kind
        assert text == "interrupted; nothing was left half-written\n"
    assert list(tmp_path.iterdir()) == [earlier]
    assert not list(earlier.iterdir())


def test_a_signal_before_the_libraries_are_there():
    code = "import time; from mvedge._run import listen; listen(); print('up', flush=True)"
    code += "; time.sleep(60)"
    process = subprocess.Popen(
        [sys.executable, "-c", _HEARD + code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=30)
    assert process.returncode == 130
    assert text == "interrupted; nothing was left half-written\n"


def test_a_signal_ends_what_waits_for_a_reader_that_never_reads():
    code = """
import sys
from mvedge._run import listen

listen()
from mvedge_jax.cli._common import note

print("inside", file=sys.stderr, flush=True)
note("x" * 10**6)
"""
    with subprocess.Popen(
        [sys.executable, "-c", _HEARD + code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "inside\n"
        time.sleep(0.5)  # the pipe is full by then, or is filled after the signal
        process.send_signal(signal.SIGTERM)
        try:
            assert process.wait(timeout=30) == 143
        finally:
            process.kill()
        assert process.stderr.read() == "interrupted; nothing was left half-written\n"
