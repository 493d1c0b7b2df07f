"""Signals at random moments of a command: `python tests/hostile/signals.py --moments 40`.

Every run has to end with 128 plus the number of the signal; it leaves no file and no folder behind,
an earlier result as it was, no traceback, and at most two lines. A run that was done before its
signal, or whose result was in place and the process ending just then, does not count: another
moment is drawn.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from datasets.layouts import write_hci

_KINDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Seconds that the process may take to end after a signal; and one that was ending anyway, with 0.
_PATIENCE, _ENDING = 20.0, 1.0


def scene(folder: Path) -> Path:
    """A light field that the chain takes a second or two for: a plane with texture."""
    texture = np.random.default_rng(0).integers(40, 200, (40, 48, 3)).astype(np.uint8)
    views = np.stack([np.stack([np.roll(texture, 1 - u, 1) for u in range(3)])] * 3)
    return write_hci(folder / "scene", views, settings=False)


def stamp(out: Path) -> int:
    """When the result was put together, in nanoseconds; 0 if it is not what it lists, no more."""
    marker = out / ".mvedge.json"
    try:
        listed = set(json.loads(marker.read_text())["written"])
    except (OSError, ValueError):
        return 0
    whole = listed == {path.relative_to(out).as_posix() for path in out.rglob("*")}
    return marker.stat().st_mtime_ns if whole else 0


def interrupted(
    words: list[str], kind: signal.Signals, after: float, out: Path
) -> tuple[str, float, bool]:
    """Starts `mvedge`, sends a signal after some seconds, and looks at what is left.

    Returns:
        What is wrong; seconds from the signal to the end; whether the signal came too late.
    """
    before, earlier = {path.name for path in out.parent.iterdir()}, stamp(out)
    call = [sys.executable, "-m", "mvedge", *words]
    process = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    late, start = True, time.perf_counter() + after
    try:
        _, text = process.communicate(timeout=after)
    except subprocess.TimeoutExpired:
        late = False
        process.send_signal(kind)
        try:
            _, text = process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return f"still running {_PATIENCE:g} s after it", _PATIENCE, False
    delay, code = time.perf_counter() - start, process.returncode
    left = {path.name for path in out.parent.iterdir()} ^ before
    complaints = [line for line in text.splitlines() if not line.startswith(("done", "warning"))]
    late = late or (code == 0 and stamp(out) != earlier and delay < _ENDING)
    verdict = ""
    if code != (0 if late else 128 + kind):
        verdict = f"exit code {code}"
    elif "Traceback" in text or len(complaints) > 2:
        verdict = f"said {complaints[-3:]}"
    elif left:
        verdict = f"left or lost {left}"
    elif not stamp(out):
        verdict = "left half a result"
    return verdict, delay, late


def main() -> int:
    """Interrupts `depth` and `optimize` at random moments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for kind in _KINDS:
        # A shell has what it runs in the background ignore some, and children inherit that.
        signal.signal(kind, signal.default_int_handler)
    draw, bad, lates, delays = random.Random(options.seed), 0, 0, []
    with tempfile.TemporaryDirectory() as name:
        field, out = scene(Path(name)), Path(name) / "out"
        runs = {}
        for command, more in (("depth", []), ("optimize", ["--iterations", "8"])):
            words = [command, str(field), str(out), "--overwrite", *more]
            call = [sys.executable, "-m", "mvedge", *words]
            subprocess.run(call, check=True, capture_output=True)  # fills the compilation cache
            start = time.perf_counter()
            subprocess.run(call, check=True, capture_output=True)
            runs[command] = time.perf_counter() - start, words
            print(f"{command}: {runs[command][0]:.1f} s")  # noqa: T201
        while len(delays) < options.moments:
            command, index = draw.choice(sorted(runs)), len(delays)
            seconds, words = runs[command]
            # Every second one falls into the first seconds, in which libraries are imported.
            after = draw.uniform(0.3, min(4.0, seconds)) if index % 2 else draw.random() * seconds
            kind = draw.choice(_KINDS)
            verdict, delay, late = interrupted(words, kind, after, out)
            if late and not verdict:
                # The machine was less busy than when the run was timed.
                lates, runs[command] = lates + 1, (after, words)
                continue
            bad += bool(verdict)
            delays.append(delay)
            said = f"{index:3} {command} {kind.name} at {after:.1f} s: {delay:.2f} s"
            print(f"{said}, {verdict or 'fine'}", flush=True)  # noqa: T201
    print(f"{len(delays)} moments, {lates} too late; {bad} bad, {max(delays):.1f} s at most")  # noqa: T201
    return min(bad, 100)


if __name__ == "__main__":
    os.environ.setdefault("MVEDGE_CACHE", tempfile.gettempdir() + "/mvedge_signals_cache")
    sys.exit(main())
