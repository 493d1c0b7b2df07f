"""Light fields per second of `mvedge batch` on a Dask cluster, and what a lost worker costs.

    python experiments/benchmarks/batch_machines.py --out results/batch_machines

A scheduler and its workers are started by hand, each worker with a processor core of its own. Three
runs over the same light fields: one worker, two workers, and two of which one is killed in the
middle. The cache of programs is shared, and filled by the first run. Rates are those after two
results per worker, so that neither compilation nor the reading of programs counts. On a machine
that does other work the rates of two runs cannot be compared: the load and the workers' CPU seconds
per light field stand beside them. Estimations are counted in the workers' own logs, results in the
folder.
"""

import argparse
import collections
import contextlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments._report import ROOT, print_table, write_json
from mvedge_jax.cli._output import MARKER
from mvedge_jax.datasets import synthetic, write_hci

DASK = [sys.executable, "-m", "dask"]


def main() -> None:
    """Runs all three."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/batch_machines"))
    parser.add_argument("--count", type=int, default=200, help="light fields")
    parser.add_argument("--shape", type=int, nargs=4, default=(3, 3, 32, 40))
    parser.add_argument("--preset", default="full")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scenes = _scenes(folder / "scenes", arguments.count, tuple(arguments.shape))
        rows = []
        for workers, killed in ((1, False), (2, False), (2, True)):
            run = folder / f"{workers}{'_killed' if killed else ''}"
            run.mkdir()
            rows.append(_run(run, folder / "cache", scenes, workers, killed, arguments.preset))
            rows[-1]["ratio to one worker"] = (
                rows[-1]["light fields per s"] / (rows[0]["light fields per s"])
            )
            print(rows[-1].pop("log"), flush=True)
            print_table(rows, title=f"{arguments.count} light fields, {arguments.shape}")
    write_json(arguments.out / "batch_machines.json", rows)


def _scenes(folder: Path, count: int, shape: tuple[int, int, int, int]) -> list[Path]:
    """Copies of one light field that is rendered once."""
    light_field = synthetic.render(synthetic.scene("demo"), shape=shape, key=jax.random.key(0))
    scenes = [folder / f"s{i:03}" for i in range(count)]
    write_hci(light_field, scenes[0])
    for scene in scenes[1:]:
        shutil.copytree(scenes[0], scene)
    return scenes


def _run(
    folder: Path, cache: Path, scenes: list[Path], workers: int, killed: bool, preset: str
) -> dict[str, Any]:
    """A batch on a cluster of its own."""
    out = folder / "out"
    with _cluster(folder, cache, workers) as (address, processes):
        words = ["batch", *map(str, scenes), str(out), "--preset", preset, "--scheduler", address]
        with (folder / "log").open("w") as log:
            command = [sys.executable, "-m", "mvedge", *words]
            batch = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)
            spent, warm = {}, None
            while batch.poll() is None:
                for process in processes[1:]:
                    with contextlib.suppress(psutil.Error):
                        used = psutil.Process(process.pid).cpu_times()
                        spent[process.pid] = used.user + used.system
                count = len(_finished(out))
                if warm is None and count >= 2 * workers:
                    warm = count, sum(spent.values()), os.getloadavg()[0]
                if killed and count >= len(scenes) // 2:
                    processes[-1].kill()
                    killed = False
                time.sleep(0.1)
    assert warm is not None, (folder / "log").read_text()
    log = (folder / "log").read_text()
    done = collections.Counter(re.findall(r"(?m)^(\S+): done by", log))
    again = re.findall(r"(?m)^(\S+: done by \S+, attempt [2-9].*)$", log)
    told = "".join(path.read_text() for path in folder.glob("worker*"))
    estimated = collections.Counter(re.findall(r"done estimating depth of (\S+)", told))
    ends = _finished(out)
    left, seconds = len(ends) - warm[0], ends[-1] - ends[warm[0] - 1]
    return {
        "workers": workers,
        "killed": int(len(processes) > 1 and processes[-1].returncode == -9),
        "light fields": len(scenes),
        "exit code": batch.returncode,
        "results": len(ends),
        "lost": len(scenes) - len(ends),
        "told twice": sum(count > 1 for count in done.values()),
        "estimated twice": sum(count > 1 for count in estimated.values()),
        "second attempts": len(again),
        "s": seconds,
        "light fields per s": left / seconds,
        "CPU s per light field": (sum(spent.values()) - warm[1]) / left,
        "load": (warm[2] + os.getloadavg()[0]) / 2,
        "log": "\n".join([*again, *log.splitlines()[-1:]]),
    }


def _finished(out: Path) -> list[float]:
    """When each complete result was written, in order."""
    return sorted(path.stat().st_mtime for path in out.glob(f"s*/{MARKER}"))


@contextlib.contextmanager
def _cluster(
    folder: Path, cache: Path, workers: int
) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A scheduler and workers without nannies: what is killed stays away."""
    told = folder / "scheduler.json"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker = ["worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    commands = [scheduler, *(worker for _ in range(workers))]
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "MVEDGE_CACHE": str(cache), "PYTHONPATH": path}
    processes = []
    try:
        for i, words in enumerate(commands):
            with (folder / ("scheduler" if i == 0 else f"worker {i}")).open("w") as log:
                processes.append(
                    subprocess.Popen(
                        [*DASK, *words, "--scheduler-file", str(told)],
                        cwd=folder,
                        env=environment,
                        stdout=log,
                        stderr=log,
                    )
                )
            if i:
                os.sched_setaffinity(processes[-1].pid, {(i - 1) % (os.cpu_count() or 1)})
        while not (told.exists() and told.read_text()):
            time.sleep(0.1)
        yield json.loads(told.read_text())["address"], processes
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


if __name__ == "__main__":
    main()
