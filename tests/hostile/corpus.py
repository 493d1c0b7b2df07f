"""All hostile cases, and a process in which they are run, one after the other, within limits."""

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import NamedTuple

from hostile import (
    arguments,
    claims,
    commands,
    containers,
    folders,
    metadata,
    mutations,
    readers,
)
from hostile.case import Case

# Limits of a case.
SECONDS, BYTES = 120, 2 * 2**30


def every_case() -> list[Case]:
    """All cases; their names are unique."""
    rooms = (mutations, claims, metadata, containers, folders, arguments, commands, readers)
    found = [case for room in rooms for case in room.cases()]
    names = [case.name for case in found]
    twice = {name for name in names if names.count(name) > 1}
    assert not twice, twice
    return found


class Outcome(NamedTuple):
    """How a case ended.

    Attributes:
        verdict: empty if all is well.
        seconds: it took.
        bytes: most memory that the process held meanwhile.
    """

    verdict: str
    seconds: float
    bytes: int


class Worker:
    """A process that runs cases; a new one takes over where one is killed or dies."""

    def __init__(self):
        self._process = None

    def run(self, case: Case) -> Outcome:
        """Runs one case, and kills the process if it passes a limit."""
        process = self._alive()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(case.name) + "\n")
        process.stdin.flush()
        start = time.perf_counter()
        while not select.select([process.stdout], [], [], 0.2)[0]:
            seconds, held = time.perf_counter() - start, memory(process.pid, "VmRSS")
            if seconds > SECONDS or held > BYTES:
                process.kill()
                process.wait()
                verdict = f"took {held / 2**30:.1f} GiB" if held > BYTES else "ran too long"
                return Outcome(verdict, seconds, held)
        line = process.stdout.readline()
        if not line:
            return Outcome(f"died with code {process.wait()}", time.perf_counter() - start, 0)
        return Outcome(*json.loads(line))

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None and self._process.poll() is None:
            self._process.communicate()

    def _alive(self) -> subprocess.Popen:
        if self._process is None or self._process.poll() is not None:
            script = Path(__file__).with_name("run.py")
            self._process = subprocess.Popen(
                [sys.executable, str(script), "--worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            assert self._process.stdout is not None
            self._process.stdout.readline()  # it has imported everything
        return self._process


def work() -> None:
    """What a worker does: names come in, outcomes go out."""
    known = {case.name: case for case in every_case()}
    answers = os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        answers.write("ready\n")
        answers.flush()
        for line in sys.stdin:
            said.seek(0)
            said.truncate()
            with contextlib.suppress(OSError):
                Path("/proc/self/clear_refs").write_text("5")  # forgets the peak so far
            start, verdict = time.perf_counter(), ""
            with tempfile.TemporaryDirectory() as folder:
                try:
                    known[json.loads(line)].run(Path(folder))
                except BaseException as error:
                    place = traceback.extract_tb(error.__traceback__)[-1]
                    where = f"{Path(place.filename).name}:{place.lineno}"
                    verdict = f"{type(error).__name__}: {error} ({where})"
            seconds, held = time.perf_counter() - start, memory(os.getpid(), "VmHWM")
            sys.stdout.flush()
            sys.stderr.flush()
            said.seek(0)
            text = said.read().decode(errors="replace").strip()
            if not verdict and text:
                verdict = f"a library spoke: {text.splitlines()[0]}"
            if not verdict and held > BYTES:
                verdict = f"took {held / 2**30:.1f} GiB"
            answers.write(json.dumps([verdict, seconds, held]) + "\n")
            answers.flush()


def memory(process: int, key: str) -> int:
    """Bytes that a process holds, or held at most."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{process}/status").read_text().splitlines():
            if line.startswith(key + ":"):
                return 1024 * int(line.split()[1])
    return 0
