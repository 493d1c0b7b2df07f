"""Runs the whole corpus with limits of time and memory: `python tests/hostile/run.py`.

`--only WORD` picks the cases whose names hold it. The exit code is the number of failures, at most
100; the slowest and the largest case end the report. A case that passes a limit ends the run.
"""

import argparse
import contextlib
import faulthandler
import os
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TextIO

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).parents[1]))

import hostile.test_corpus  # noqa: F401  (it registers the cases)
from hostile.case import CASES, Case

# Limits of a case.
SECONDS, BYTES = 120, 2 * 2**30


def memory(key: str) -> int:
    """Bytes that this process holds, or held at most."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(key + ":"):
                return 1024 * int(line.split()[1])
    return 0


def watch(terminal: int, running: list[str]) -> None:
    """Ends the process when it holds too much."""
    while True:
        time.sleep(0.2)
        if memory("VmRSS") > BYTES:
            os.write(terminal, f"FAILED  {running[-1]!r} took too much memory\n".encode())
            os._exit(1)


def verdict_of(case: Case) -> str:
    """Runs a case in an empty folder; what went wrong, or nothing."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            case.run(Path(folder))
        except BaseException as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}:{place.lineno}"
            return f"{type(error).__name__}: {error} ({where})"
    return ""


def outcomes(only: str, report: TextIO, said: BinaryIO) -> Iterator[tuple[str, str, float, int]]:
    """Runs the cases; their names, what went wrong, seconds, and the most bytes held meanwhile."""
    running = [""]
    threading.Thread(target=watch, args=(report.fileno(), running), daemon=True).start()
    for name, case in CASES.items():
        if only not in name:
            continue
        running.append(name)
        said.truncate(0)
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")  # forgets the peak so far
        faulthandler.dump_traceback_later(SECONDS, exit=True, file=report)
        start = time.perf_counter()
        verdict = verdict_of(case)
        seconds, held = time.perf_counter() - start, memory("VmHWM")
        faulthandler.cancel_dump_traceback_later()
        said.seek(0)
        text = said.read().decode(errors="replace").strip("\0 \n")
        if text and not verdict:
            verdict = f"a library spoke: {text.splitlines()[0]}"
        if held > BYTES and not verdict:
            verdict = f"took {held / 2**30:.1f} GiB"
        yield name, verdict, seconds, held


def main() -> int:
    """Runs the cases and prints what failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="a part of the names")
    options = parser.parse_args()
    found = []
    with os.fdopen(os.dup(1), "w", buffering=1) as report, tempfile.TemporaryFile() as said:
        # What libraries write goes to a file: no case may have them say anything.
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        for name, verdict, seconds, held in outcomes(options.only, report, said):
            found.append((name, bool(verdict), seconds, held))
            if verdict:
                report.write(f"FAILED  {name!r}: {verdict}\n")
        bad = sum(failed for _, failed, _, _ in found)
        report.write(f"{len(found)} cases, {bad} failed, {sum(row[2] for row in found):.0f} s\n")
        for title, column in (("slowest", 2), ("largest", 3)):
            name, _, seconds, held = max(found, key=lambda row: row[column])
            report.write(f"{title}: {name!r}, {seconds:.1f} s, {held / 2**30:.2f} GiB\n")
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
