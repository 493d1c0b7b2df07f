"""Every table and figure by one command, with one page that shows them all.

    python experiments/all.py --tier quick --out results/all
    python experiments/all.py --tier full --only table_6_1 robustness
    python experiments/all.py --tier full --jobs 2

Each script runs in a process of its own, long ones first; one that fails, or runs out of time
(`--limit`, 25 minutes in the full tier), stops no other.
What finished at this commit with the same arguments is not run again. The page, `index.html`,
shows what each script wrote: its tables, its pictures, its seconds, or why there is nothing.
`quick` uses small rendered scenes; `full` the published sizes and, where it is there, the
development data.

Scripts share a folder of compiled programs; benchmarks, which time the compiler, too, do not, and
run one by one after the others, on all cores. With `--jobs` other scripts share the cores out among
them, which takes a seventh less of the processor than all of them on every core, and the seconds in
their tables are those of a busy machine. What the pages of the documentation show is renewed by

    python experiments/pages.py --take results/all/table_edges/*.json
"""

import argparse
import contextlib
import html
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from queue import SimpleQueue
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._items import ITEMS, Item
from experiments._report import commit as commit_now, environment, print_table, shared_data

HERE = Path(__file__).resolve().parent
# Seconds after which a script is stopped.
LIMITS = {"quick": 600, "full": 1500}


def main() -> int:
    """Runs a tier and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tier", choices=list(LIMITS), default="quick")
    parser.add_argument("--out", type=Path, default=Path("results/all"))
    parser.add_argument("--only", nargs="*", default=[], choices=[item.name for item in ITEMS])
    parser.add_argument("--again", action="store_true", help="run what is there already, too")
    parser.add_argument("--limit", type=float, default=None, help="seconds per script")
    parser.add_argument("--jobs", type=int, default=1, help="scripts at once, besides benchmarks")
    arguments = parser.parse_args()
    commit = commit_now()
    limit = arguments.limit or LIMITS[arguments.tier]
    begun = time.perf_counter()
    asked = [item for item in ITEMS if not arguments.only or item.name in arguments.only]
    asked.sort(key=lambda item: -item.seconds)
    rows = {
        item.name: _earlier(item, arguments.out / item.name, commit)
        for item in ITEMS
        if item not in asked
    }

    def run(item: Item) -> dict[str, Any]:
        place = arguments.out / item.name
        return _run(item, arguments.tier, place, commit, limit, arguments.again)

    def ordered() -> list[dict[str, Any]]:
        return [rows[item.name] for item in ITEMS if item.name in rows]

    def note(row: dict[str, Any]) -> None:
        rows[row["name"]] = row
        print(f"{row['name']}: {row['state']}, {row['seconds']:.0f} s", flush=True)
        _write_page(arguments.out, arguments.tier, commit, ordered())

    shares = _cores(arguments.jobs)
    with ThreadPoolExecutor(arguments.jobs, initializer=_pin, initargs=(shares,)) as pool:
        running = [pool.submit(run, item) for item in asked if not _is_benchmark(item)]
        for future in as_completed(running):
            note(future.result())
    for item in filter(_is_benchmark, asked):
        note(run(item))
    minutes = (time.perf_counter() - begun) / 60
    print_table(
        [{name: row[name] for name in ("name", "what", "state", "seconds")} for row in ordered()],
        title=f"{arguments.tier}, {commit}, {minutes:.0f} minutes",
    )
    print(f"{arguments.out / 'index.html'}")
    return int(any(row["state"] == "failed" for row in rows.values()))


def _cores(jobs: int) -> SimpleQueue[set[int]]:
    """Shares of this machine's cores, one for each of the scripts that run at once."""
    shares: SimpleQueue[set[int]] = SimpleQueue()
    if hasattr(os, "sched_getaffinity"):  # Linux
        cores = sorted(os.sched_getaffinity(0))
        for job in range(jobs):
            shares.put(set(cores[job::jobs]) or set(cores))
    return shares


def _pin(shares: SimpleQueue[set[int]]) -> None:
    """Keeps what this thread starts to its share of the cores."""
    if not shares.empty():
        os.sched_setaffinity(0, shares.get())


def _is_benchmark(item: Item) -> bool:
    """Whether it times the compiler, too, and has to run alone."""
    return item.script.startswith("benchmarks/")


def _earlier(item: Item, out: Path, commit: str) -> dict[str, Any]:
    """What an earlier run left of an item that is not asked for: it stays on the page."""
    record = out / "run.json"
    if record.exists():
        return {**json.loads(record.read_text(encoding="utf-8")), "what": item.what}
    row = {"name": item.name, "what": item.what, "seconds": 0.0, "commit": commit}
    return {**row, "state": "left out", "why": "not asked for, and not run before"}


def _run(
    item: Item, tier: str, out: Path, commit: str, limit: float, again: bool
) -> dict[str, Any]:
    """Runs a script, or reads what an earlier run left."""
    words = item.quick if tier == "quick" else item.full
    row = {"name": item.name, "what": item.what, "seconds": 0.0, "commit": commit}
    if words is None:
        return {**row, "state": "left out", "why": "only in the full tier"}
    data = shared_data()
    if data is None and ("{data}" in words or "hci/" in words):
        return {**row, "state": "left out", "why": "the development data is not there"}
    words = words.format(data=data)
    command = [sys.executable, str(HERE / item.script), *words.split(), "--out", str(out)]
    record = out / "run.json"
    if not again and record.exists():
        earlier = json.loads(record.read_text(encoding="utf-8"))
        if earlier["commit"] == commit and earlier["words"] == words and earlier["state"] == "done":
            return {**earlier, "what": item.what}
    out.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    with (out / "log.txt").open("w", encoding="utf-8") as log:
        process = subprocess.Popen(
            command,
            cwd=HERE.parent,
            env=_environment(item, out.parent / "programs"),
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = process.wait(limit)
            why = "" if code == 0 else f"exit code {code}"
        except subprocess.TimeoutExpired:
            why = f"stopped after {limit:.0f} s"
        finally:
            # Whatever it has started, such as workers, ends with it.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    row.update(
        state="failed" if why else "done",
        why=why,
        seconds=round(time.perf_counter() - start, 1),
        words=words,
        command=f"python experiments/{item.script} {words}".strip(),
    )
    record.write_text(json.dumps(row, indent=2), encoding="utf-8")
    return row


def _environment(item: Item, programs: Path) -> dict[str, str]:
    """Variables of a script's process: where it finds what other scripts have compiled."""
    if _is_benchmark(item):
        return dict(os.environ)
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(programs.resolve()),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
    }
    return {**os.environ, **cache}


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums }
th, td { border-bottom: 1px solid #ccc; padding: .15rem .7rem; text-align: right }
th:first-child, td:first-child { text-align: left }
img { max-width: 100% } pre { background: #f4f4f4; padding: .6rem; overflow: auto }
.failed { color: #a00 } .wide { overflow: auto }
"""


def _write_page(out: Path, tier: str, commit: str, rows: Sequence[dict[str, Any]]) -> None:
    """The page, rewritten after each script, so that a stopped run has one, too."""
    machine = ", ".join(f"{name} {value}" for name, value in environment().items())
    summary = [
        {
            "name": f'<a href="#{row["name"]}">{row["name"]}</a>',
            "shows": html.escape(row["what"]),
            "state": f'<span class="{row["state"]}">{row["state"]}</span>',
            "seconds": _cell(row["seconds"]),
        }
        for row in rows
    ]
    parts = [
        f"<!doctype html><meta charset=utf-8><title>mvedge_jax: {tier}</title>",
        f"<style>{_STYLE}</style><h1>mvedge_jax: tables and figures, {tier}</h1>",
        f"<p>Commit {html.escape(commit)}; {html.escape(machine)}.</p>",
        _table(summary),
        *(part for row in rows for part in _section(out, row)),
    ]
    out.mkdir(parents=True, exist_ok=True)
    (out / "index.html").write_text("\n".join(parts), encoding="utf-8")


def _section(out: Path, row: dict[str, Any]) -> Iterator[str]:
    folder = out / row["name"]
    yield f'<h2 id="{row["name"]}">{html.escape(row["what"])}</h2>'
    if row["state"] == "left out":
        yield f"<p>Left out: {html.escape(row['why'])}.</p>"
        return
    ran = f"{row['seconds']} s at {html.escape(row['commit'])}"
    yield f"<p><code>{html.escape(row['command'])}</code>, {ran}</p>"
    if row["state"] == "failed":
        log = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")
        yield f'<p class="failed">{html.escape(row["why"])}</p>'
        yield f"<pre>{html.escape(log[-3000:])}</pre>"
    for path in sorted(folder.rglob("*.json")):
        if path.name == "run.json":
            continue
        for title, table in _tables(json.loads(path.read_text(encoding="utf-8")), path.stem):
            yield f"<h3>{html.escape(title)}</h3>{_table(_escaped(table))}"
    for path in sorted(folder.rglob("*.png")):
        where = html.escape(path.relative_to(out).as_posix())
        yield f'<p><img src="{where}" alt="{html.escape(path.stem)}" loading="lazy"></p>'


def _tables(content: Any, title: str) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Lists of rows anywhere in a result, and single rows of numbers and text."""
    if isinstance(content, dict) and {"environment", "content"} <= set(content):
        content = content["content"]
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        yield title, [_flat(row) for row in content]
    elif isinstance(content, dict):
        nested = {name: part for name, part in content.items() if isinstance(part, dict | list)}
        plain = {name: part for name, part in content.items() if name not in nested}
        if plain:
            yield title, [plain]
        for name, part in nested.items():
            yield from _tables(part, f"{title}: {name}")


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    """What fits into a cell."""
    return {name: part for name, part in row.items() if not isinstance(part, dict | list)}


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


def _escaped(rows: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    return [
        {html.escape(str(name)): html.escape(_cell(value)) for name, value in row.items()}
        for row in rows
    ]


def _table(rows: Sequence[dict[str, str]]) -> str:
    """Rows of HTML as a table; columns are those of all rows, in order of appearance."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(f"<th>{name}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{row.get(name, '')}</td>" for name in columns) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


if __name__ == "__main__":
    sys.exit(main())
