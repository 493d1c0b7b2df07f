"""Signals at random moments of a command: `python tests/hostile/signals.py --moments 40`.

Every run has to end with 128 plus the number of the signal or, if it was being put in place just
then, with 0; it leaves no file and no folder behind, no traceback, and at most two lines. A run
that was done before its signal does not count, and another moment is drawn.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from datasets.layouts import write_hci

_KINDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Seconds that the process may take to end after a signal.
_PATIENCE = 20.0


class Moment(NamedTuple):
    """What a signal did.

    Attributes:
        verdict: empty if all is well.
        code: exit code of the process, negative for the signal that killed it.
        delay: seconds from the signal to the end.
        late: the run was done before the signal.
    """

    verdict: str
    code: int
    delay: float
    late: bool = False


def scene(folder: Path) -> Path:
    """A light field that the chain takes a second or two for: a plane with texture."""
    texture = np.random.default_rng(0).integers(40, 200, (40, 48, 3)).astype(np.uint8)
    views = np.stack([np.stack([np.roll(texture, 1 - u, 1) for u in range(3)])] * 3)
    return write_hci(folder / "scene", views, settings=False)


def interrupted(words: list[str], kind: signal.Signals, after: float, out: Path) -> Moment:
    """Starts `mvedge`, sends a signal after some seconds, and looks at what is left."""
    before = {path.name for path in out.parent.iterdir()}
    process = subprocess.Popen(
        [sys.executable, "-m", "mvedge", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    late = False
    try:
        _, text = process.communicate(timeout=after)
        late, start = True, time.perf_counter()
    except subprocess.TimeoutExpired:
        start = time.perf_counter()
        process.send_signal(kind)
        try:
            _, text = process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            _, text = process.communicate()
            return Moment(f"still running {_PATIENCE:g} s after {kind.name}", 0, _PATIENCE)
    delay = time.perf_counter() - start
    code = process.returncode
    left = {path.name for path in out.parent.iterdir()} - before
    complaints = [line for line in text.splitlines() if not line.startswith(("done", "warning"))]
    verdict = ""
    if code not in (0, 128 + kind):
        verdict = f"exit code {code}"
    elif "Traceback" in text or len(complaints) > 2:
        verdict = f"said {complaints[-3:]}"
    elif left - {out.name}:
        verdict = f"left {left}"
    elif out.name in left and not (out / ".mvedge.json").is_file():
        verdict = "left half a result"
    return Moment(verdict, code, delay, late)


def main() -> int:
    """Interrupts `depth` and `optimize` at random moments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    draw, bad, late, delays = random.Random(options.seed), 0, 0, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        field, out = scene(folder), folder / "out"
        whole = {}
        for command, more in (("depth", []), ("optimize", ["--iterations", "8"])):
            words = [command, str(field), str(out), "--overwrite", *more]
            call = [sys.executable, "-m", "mvedge", *words]
            subprocess.run(call, check=True, capture_output=True)  # fills the compilation cache
            start = time.perf_counter()
            subprocess.run(call, check=True, capture_output=True)
            whole[command] = time.perf_counter() - start, words
            sys.stdout.write(f"{command}: {whole[command][0]:.1f} s\n")
        while len(delays) < options.moments:
            command, index = draw.choice(sorted(whole)), len(delays)
            seconds, words = whole[command]
            # Every second one falls into the first seconds, in which libraries are imported.
            after = draw.uniform(0.3, min(4.0, seconds)) if index % 2 else draw.random() * seconds
            kind = draw.choice(_KINDS)
            found = interrupted(words, kind, after, out)
            if found.late and not found.verdict:
                # The machine was less busy than when the run was timed.
                late, whole[command] = late + 1, (after, words)
                continue
            bad += bool(found.verdict)
            delays.append(found.delay)
            sys.stdout.write(
                f"{index:3} {words[0]} {kind.name} at {after:.1f} s: code {found.code}, "
                f"{found.delay:.2f} s, {found.verdict or 'fine'}\n"
            )
            sys.stdout.flush()
    sys.stdout.write(
        f"{options.moments} moments within a run, {late} after its end; {bad} bad, "
        f"{max(delays):.1f} s at most\n"
    )
    return min(bad, 100)


if __name__ == "__main__":
    os.environ.setdefault("MVEDGE_CACHE", tempfile.gettempdir() + "/mvedge_signals_cache")
    sys.exit(main())
