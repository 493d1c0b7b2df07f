"""Common functions of the commands: progress, printable messages, checks, compilation."""

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from mvedge_jax._cpu import release_memory
from mvedge_jax._stored_views import StoredViews
from mvedge_jax.lightfield import LightField

from ._interruption import GUARD

# Titles of the scores of a depth map.
SCORES = {
    "mse": "MSE*100",
    "q25": "Q25*100",
    "bad_01": "BP(0.01) %",
    "bad_03": "BP(0.03) %",
    "bad_07": "BP(0.07) %",
}
# File names are printed literally: no markup, no emoji for `:names:`, no highlighting.
_PROGRESS = Console(stderr=True, markup=False, emoji=False, highlight=False)


def printable(text: str) -> str:
    """Text in one line, with control characters and undecodable bytes as escapes."""
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return "".join(shown)


class _Elapsed:
    """A line with the seconds since `start`, updated with the terminal."""

    def __init__(self, name: str, start: float):
        self._name, self._start = name, start

    def __rich__(self) -> Text:
        return Text(f"{self._name} ({time.perf_counter() - self._start:.0f} s)")


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """Shows `name`, a spinner and the seconds while the body runs, and its time when it is done.

    The spinner is shown on a terminal only.
    """
    start, name = time.perf_counter(), printable(name)
    with _PROGRESS.status(_Elapsed(name, start)):  # pyright: ignore
        yield
    _say(("done", "green"), f" {name} ({time.perf_counter() - start:.1f} s)")


def progress_bar() -> Progress:
    """What is done of what there is, and the time it took."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
    )


def positions_of(light_field: LightField | StoredViews) -> str:
    """Positions of the views, in words."""
    if light_field.positions is None:
        return "regular grid"
    rows, columns = light_field.available.shape
    places = np.asarray(light_field.positions)
    apart = []
    for name, number, axis in (("columns", 0, 1), ("rows", 1, 0)):
        if places.shape[axis] > 1:
            steps = np.diff(places[..., number], axis=axis)
            apart.append(f"{name} {steps.min():.3g} .. {steps.max():.3g} apart")
    return f"not regular: {rows}x{columns} views, {', '.join(apart)} (view steps)"


def note(text: str) -> None:
    """Prints lines to the standard output; a closed pipe is not an error."""
    lines = "\n".join(printable(line) for line in text.split("\n"))
    with GUARD:
        try:
            sys.stdout.write(lines + "\n")
            sys.stdout.flush()
        except OSError:
            # A closed pipe or a full disk must not lose the result, and the rest of the buffer
            # must not raise when the interpreter exits.
            sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


def warn(text: str) -> None:
    """Prints a warning to the standard error."""
    _say(("warning", "yellow"), " " + printable(text))


def _say(*parts: str | tuple[str, str]) -> None:
    with GUARD, contextlib.suppress(OSError):
        _PROGRESS.print(Text.assemble(*parts), soft_wrap=True)


def finite(**options: Sequence[float] | float | None) -> None:
    """Refuses options that are NaN or infinite, by name; None is fine."""
    for name, value in options.items():
        if value is not None and not np.isfinite(value).all():
            raise ValueError(f"--{name} must be finite, got {value}.")


def in_unit_range(color: Sequence[float] | None) -> None:
    """Refuses a --color that is not within 0 and 1."""
    if color is not None and not all(0 <= value <= 1 for value in color):
        raise ValueError(f"--color must be three numbers between 0 and 1, got {color}.")


def missing_views(light_field: LightField | StoredViews) -> list[str]:
    """A sentence about missing views, if there are any."""
    there = np.asarray(light_field.available)
    if there.all():
        return []
    return [f"{int((~there).sum())} of {there.size} views are missing; the others were used."]


def compiled(function: Any, *arguments: Any, **options: Any) -> Callable[..., Any]:
    """The program of a `lean_jit` function for such arguments, compiled or read from its file.

    The compiler's free memory is returned to the system.
    """
    program = function.ahead(*arguments, **options)
    release_memory()
    return program


def run(
    what: str, doing: str, function: Any, *arguments: Any, **options: Any
) -> tuple[Any, dict[str, float]]:
    """Compiles a `lean_jit` function and calls it; the result, and the seconds of both."""
    before = time.perf_counter()
    with stage(f"compiling {what}, or reading what was compiled before"):
        program = compiled(function, *arguments, **options)
    start = time.perf_counter()
    with stage(doing):
        result = jax.block_until_ready(program(*arguments, **options))
    seconds = {"compilation": start - before, "estimation": time.perf_counter() - start}
    return result, {name: round(value, 3) for name, value in seconds.items()}


def score_line(name: str, scores: Mapping[str, float]) -> str:
    """Scores of a map in a line."""
    return f"{name}: " + "  ".join(f"{SCORES[key]} {scores[key]:.4g}" for key in SCORES)


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """A table as text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.rjust, row, widths)) for row in rows)
