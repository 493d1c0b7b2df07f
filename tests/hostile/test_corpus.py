"""The corpus of hostile inputs, each within 120 s and 2 GiB of memory."""

import contextlib
import faulthandler
import importlib
import os
import threading
from pathlib import Path

import pytest
from hostile.case import CASES

MODULES = (
    "mutations", "claims", "metadata", "containers", "folders", "arguments", "names", "words",
    "results", "commands",
)  # fmt: skip
for module in MODULES:  # each registers its cases
    importlib.import_module(f"hostile.{module}")
SECONDS, BYTES = 120, 2 * 2**30


def memory(key: str) -> int:
    """Bytes that this process holds, or held at most; 0 where the system does not say."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(key + ":"):
                return 1024 * int(line.split()[1])
    return 0


@pytest.fixture
def limits():
    """Ends the process when a case takes too long or far too much memory; looks at its peak."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # forgets the peak so far
    before, done = memory("VmHWM"), threading.Event()

    def watch():
        while not done.wait(0.2):
            if memory("VmRSS") - before > 2 * BYTES:
                os.write(2, b"A hostile case took too much memory.\n")
                os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    faulthandler.dump_traceback_later(SECONDS, exit=True, file=2)
    yield
    faulthandler.cancel_dump_traceback_later()
    done.set()
    assert memory("VmHWM") - before < BYTES


def test_the_corpus_is_large():
    assert len(CASES) >= 500


@pytest.mark.usefixtures("limits")
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name, marks=[] if case.fast else [pytest.mark.slow])
        for name, case in CASES.items()
    ],
)
def test_case(case, tmp_path, capfd):
    case.run(tmp_path)
    said = capfd.readouterr()
    assert not said.out + said.err, "a library spoke"
