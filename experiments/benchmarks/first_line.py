"""Seconds of the README's first line by part: environment, import, rendering, estimates, figures.

    python experiments/benchmarks/first_line.py [--install] [--out results/first_line]

`mvedge demo` runs in a process of its own without any compilation cache. Of every part: seconds of
the clock and of CPU, and how many of the clock's went into tracing and into compiling. `--install`
also makes an environment and installs the package, which needs the package index or a local copy.
"""

import argparse
import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_TREE = Path(__file__).resolve().parents[2]
_TRACING = ("/jax/core/compile/jaxpr_trace_duration", "jaxpr_to_mlir_module_duration")
_COMPILING = ("backend_compile_duration",)


def main() -> None:
    """Runs the line and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/first_line"))
    parser.add_argument("--install", action="store_true", help="measure the environment, too")
    parser.add_argument("--here", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.here is not None:
        (arguments.here / "parts.json").write_text(json.dumps(_demo(arguments.here / "demo_out")))
        return
    sys.path.insert(0, str(_TREE / "experiments"))
    from _report import print_table, write_json

    rows = []
    with tempfile.TemporaryDirectory() as name:
        if arguments.install:
            rows.append(_installed(Path(name) / "venv"))
        plain = {k: v for k, v in os.environ.items() if "CACHE" not in k}
        environment = {**plain, "PYTHONPATH": str(_TREE), "MVEDGE_CACHE": "off"}
        call = [sys.executable, str(Path(__file__).resolve()), "--here", name]
        subprocess.run(call, env=environment, check=True)
        rows += json.loads((Path(name) / "parts.json").read_text())
    keys = [key for key in rows[-1] if key != "part"]
    rows.append({"part": "sum", **{key: sum(row[key] for row in rows) for key in keys}})
    print_table(rows, title="README's first line, s")
    write_json(arguments.out / "first_line.json", rows)


def _cpu(who: int) -> float:
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def _installed(place: Path) -> dict[str, Any]:
    start, before = time.perf_counter(), _cpu(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
    subprocess.run([str(place / "bin" / "pip"), "install", "--quiet", str(_TREE)], check=True)
    return {
        "part": "environment",
        "s": time.perf_counter() - start,
        "CPU s": _cpu(resource.RUSAGE_CHILDREN) - before,
        "tracing": 0.0,
        "compiling": 0.0,
    }


def _demo(out: Path) -> list[dict[str, Any]]:
    """The parts of `mvedge demo`, in this process."""
    spent: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    current = ["import"]

    @contextlib.contextmanager
    def part(name: str) -> Iterator[None]:
        # What is in brackets or after a colon differs from run to run, or says which method.
        label, before = name.partition(",")[0], (time.perf_counter(), time.process_time())
        current.append(label)
        try:
            yield
        finally:
            current.pop()
            spent[label]["s"] += time.perf_counter() - before[0]
            spent[label]["CPU s"] += time.process_time() - before[1]

    def heard(event: str, duration_secs: float, **_: Any) -> None:
        kind = "tracing" if event.endswith(_TRACING) else "compiling"
        if event.endswith(_TRACING + _COMPILING):
            spent[current[-1]][kind] += duration_secs

    with part("import"):
        import jax

        from mvedge_jax.cli import _demo as command
    jax.monitoring.register_event_duration_secs_listener(heard)
    command.stage = part
    with part("rest"):
        command.demo(out)
    inner = [name for name in spent if name not in ("import", "rest")]
    for key in ("s", "CPU s"):
        spent["rest"][key] -= sum(spent[name][key] for name in inner)
    # The interpreter and the libraries that it loaded before the first line.
    spent["import"]["CPU s"] = _cpu(resource.RUSAGE_SELF) - sum(
        spent[name]["CPU s"] for name in [*inner, "rest"]
    )
    keys = ("s", "CPU s", "tracing", "compiling")
    return [{"part": name, **{k: spent[name][k] for k in keys}} for name in spent]


if __name__ == "__main__":
    main()
