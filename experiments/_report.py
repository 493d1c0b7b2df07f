"""What every experiment needs: timing, tables, files, and where the figures came from."""

import csv
import hashlib
import json
import os
import platform
import resource
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
from rich.console import Console
from rich.table import Table


class Timing(NamedTuple):
    """Wall-clock seconds of a function: first call (compilation included) and warm calls."""

    first: float
    median: float
    best: float
    runs: tuple[float, ...]


def timed(function: Callable, *args: Any, repeats: int = 7) -> tuple[Any, Timing]:
    """Calls `function(*args)` once cold and `repeats` times warm, waiting for its arrays.

    Returns:
        The last result and the timing.
    """
    durations = []
    result = None
    for _ in range(repeats + 1):
        start = time.perf_counter()
        result = jax.block_until_ready(function(*args))
        durations.append(time.perf_counter() - start)
    warm = durations[1:] or durations
    return result, Timing(durations[0], statistics.median(warm), min(warm), tuple(warm))


def peak_memory() -> int:
    """Peak resident set size of this process so far, bytes."""
    try:
        # What getrusage reports starts from the size of the process that started this one.
        status = Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) * 1024
    except (OSError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def environment() -> dict[str, Any]:
    """The machine and the versions that a figure depends on."""
    with open("/proc/loadavg") as file:
        load = float(file.read().split()[0])
    packages = ("jax", "jaxlib", "equinox", "numpy", "scipy")
    return {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "load": load,
        "python": platform.python_version(),
        "backend": jax.default_backend(),
        **{name: version(name) for name in packages},
    }


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


def print_table(rows: Sequence[Mapping[str, Any]], *, title: str = "") -> None:
    """Prints rows with the same keys as a table."""
    if not rows:
        return
    table = Table(title=title)
    for name in rows[0]:
        table.add_column(name, justify="left" if isinstance(rows[0][name], str) else "right")
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    Console(width=160).print(table)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes rows with the same keys as a CSV file with a header."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def commit() -> str:
    """The commit, and a digest of what experiments and package differ from it by."""
    here = Path(__file__).resolve().parent

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=here, capture_output=True, text=True)
        return done.stdout if done.returncode == 0 else ""

    name = git("rev-parse", "--short", "HEAD").strip() or "no repository"
    changes = git("diff", "HEAD", "--", ".", "../mvedge_jax")
    return f"{name}+{hashlib.sha256(changes.encode()).hexdigest()[:8]}" if changes else name


def command() -> str:
    """How this process was started, from the top of the repository."""
    top = Path(__file__).resolve().parents[1]
    script = Path(sys.argv[0]).resolve()
    place = script.relative_to(top) if script.is_relative_to(top) else script
    return shlex.join(["python", str(place), *sys.argv[1:]])


def write_json(path: Path, content: Any) -> None:
    """Writes `content` as JSON, with the commit, the command and the environment."""
    path.parent.mkdir(parents=True, exist_ok=True)
    origin = {"commit": commit(), "command": command(), "environment": environment()}
    path.write_text(json.dumps({**origin, "content": content}, indent=2))


def shared_data() -> Path | None:
    """The development data beside the repository, or None."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data"
    return path if path.is_dir() else None
