"""What every experiment needs: timing, tables, files, and where the figures came from."""

import ast
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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]


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

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
        return done.stdout if done.returncode == 0 else ""

    name = git("rev-parse", "--short", "HEAD").strip() or "no repository"
    changes = git("diff", "HEAD", "--", "experiments", ":!experiments/results", "mvedge_jax")
    return f"{name}+{hashlib.sha256(changes.encode()).hexdigest()[:8]}" if changes else name


def command() -> str:
    """How this process was started, with paths from the top of the repository.

    Without `--out`: no figure depends on the folder of the results.
    """
    script, *words = sys.argv
    if "--out" in words:
        place = words.index("--out")
        del words[place : place + 2]
    return shlex.join(
        ["python", _from_the_top(str(Path(script).resolve())), *map(_from_the_top, words)]
    )


def _from_the_top(word: str) -> str:
    """A path near the repository without the folders of this machine; other words as they are."""
    path = Path(word)
    near = path.is_absolute() and path.is_relative_to(ROOT.parent)
    return Path(os.path.relpath(path, ROOT)).as_posix() if near else word


def code_of(text: str) -> str:
    """A module's syntax tree as text, without comments, docstrings and layout."""
    return "".join(_words(ast.parse(text)))


def _words(node: Any) -> Iterator[str]:
    """Not `ast.dump`: what that leaves out, such as empty lists, depends on Python's version."""
    if isinstance(node, list):
        for each in node:
            yield from _words(each)
    elif isinstance(node, ast.AST):
        yield f"({type(node).__name__}"
        for name, value in ast.iter_fields(node):
            if name == "body" and isinstance(value, list) and value and _is_text(value[0]):
                value = value[1:]
            if isinstance(node, ast.JoinedStr):  # Python 3.12.1 adds empty texts
                value = [part for part in value if getattr(part, "value", None) != ""]
            if value is not None and value != []:
                yield f" {name}="
                yield from _words(value)
        yield ")"
    else:
        yield repr(node)


def _is_text(statement: ast.AST) -> bool:
    value = getattr(statement, "value", None)
    return isinstance(statement, ast.Expr) and isinstance(getattr(value, "value", None), str)


def digests(patterns: Iterable[str], root: Path = ROOT) -> dict[str, str]:
    """A digest of the code that each pattern of files, such as `mvedge_jax/epi/*.py`, stands for.

    Args:
        patterns: relative to `root`.
        root: top of a checkout.

    Returns:
        By pattern, 12 hexadecimal digits. Comments, docstrings and layout do not change them; of
        files that are no code, every byte does.
    """
    found = {}
    for pattern in patterns:
        digest = hashlib.sha256()
        for path in sorted(root.glob(pattern)):
            digest.update(f"{path.relative_to(root).as_posix()}\n".encode())
            code = path.suffix == ".py"
            text = code_of(path.read_text(encoding="utf-8")).encode() if code else path.read_bytes()
            digest.update(text)
        found[pattern] = digest.hexdigest()[:12]
    return found


def imported_code() -> list[str]:
    """Patterns of the repository's files that this process runs.

    Of the package, the folders that a module was imported from, with arrays that lie there; of the
    experiments, the modules besides this one.
    """
    files = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
    paths = (Path(file).resolve() for file in [*files, sys.argv[0]] if file)
    patterns = set()
    for path in paths:
        if path.suffix != ".py" or not path.is_relative_to(ROOT) or path == Path(__file__):
            continue
        place = path.relative_to(ROOT)
        if place.parts[0] == "mvedge_jax":
            patterns.add(f"{place.parent.as_posix()}/*.py")
            # What was learned is no code, but figures are of it.
            if any(path.parent.glob("*.npz")):
                patterns.add(f"{place.parent.as_posix()}/*.npz")
        elif place.parts[0] == "experiments":
            patterns.add(place.as_posix())
    return sorted(patterns)


def write_json(path: Path, content: Any, *, depends: Iterable[str] | None = None) -> None:
    """Writes what a run found as JSON, one row a line, with where it comes from.

    The file has the commit, the date, the command, the environment and the `digests` of the code
    that the figures depend on. `pages.py` puts figures into the documentation.

    Args:
        path: the file; folders are made.
        content: rows, or a dictionary of lists of rows. Numbers keep six digits.
        depends: patterns of that code; by default all that the process has imported.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    origin = {
        "commit": commit(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": command(),
        "environment": environment(),
        "depends": digests(imported_code() if depends is None else depends),
    }
    path.write_text(json_text({**origin, "content": content}), encoding="utf-8")


def json_text(content: Any) -> str:
    """JSON whose innermost dictionaries and lists stand on one line; floats keep six digits."""
    short = json.loads(json.dumps(content), parse_float=lambda digits: _short(float(digits)))
    return "".join(_layout(short, "\n")) + "\n"


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _layout(value: Any, line: str) -> Iterator[str]:
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    if not any(isinstance(part, dict | list) for part in parts):
        yield json.dumps(value, ensure_ascii=False)
        return
    names = [f"{json.dumps(name)}: " for name in value] if isinstance(value, dict) else None
    yield "{" if names else "["
    for index, part in enumerate(parts):
        yield ("," if index else "") + line + " " + (names[index] if names else "")
        yield from _layout(part, line + " ")
    yield line + ("}" if names else "]")


def shared_data() -> Path | None:
    """The development data beside the repository, or None."""
    path = ROOT.parent / "shared" / "data"
    return path if path.is_dir() else None
