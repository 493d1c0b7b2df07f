"""Limits of file contents, checked by headers before anything large is read."""

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

_DEFAULT_GB = 8.0
# 100 x 100 views; the largest rigs have 17 x 17. Numbers beyond it are damage, not cameras.
_MOST_VIEWS = 10_000
# Benchmarks' configurations have a kilobyte.
_MOST_TEXT = 1_000_000
LIFT = "`max_gb`, --max-gb or MVEDGE_MAX_GB lifts this limit"


def memory_limit(max_gb: float | None) -> float:
    """The largest size of a light field in bytes: of `max_gb`, of `MVEDGE_MAX_GB`, or 8 GB."""
    name, wish = "`max_gb`", max_gb
    if wish is None:
        name, wish = "MVEDGE_MAX_GB", os.environ.get("MVEDGE_MAX_GB") or _DEFAULT_GB
    try:
        gigabytes = float(wish)
    except (TypeError, ValueError):
        gigabytes = math.nan
    if not gigabytes > 0:
        raise ValueError(f"{name} must be a positive number of gigabytes, got {wish}.")
    return 1e9 * gigabytes


def check_memory(what: str, shape: Sequence[int], limit: float, *, size: int = 4) -> None:
    """Refuses an array of a shape, of `size` bytes per number, above a limit in bytes."""
    need = math.prod(map(int, shape)) * size
    if need > limit:
        sides = "x".join(map(str, shape))
        raise ValueError(
            f"{what} claims {sides} numbers, {need / 1e9:,.1f} GB in memory; expected at most "
            f"{limit / 1e9:g} GB ({LIFT})."
        )


def check_grid(where: Path | str, rows: int, columns: int) -> None:
    """Refuses grids of more than 10,000 views."""
    if rows * columns > _MOST_VIEWS:
        raise ValueError(
            f"{where} claims a grid of {_number(rows)}x{_number(columns)} views (rows x columns); "
            f"expected at most {_MOST_VIEWS} views, numbered without large gaps."
        )


def read_text(path: Path) -> str:
    """Reads a small text file in UTF-8, with or without a byte order mark.

    Devices and pipes, which may have no end, long files and other encodings are ValueErrors.
    """
    if not path.is_file():
        raise ValueError(f"{path} is not a regular file; expected a text file.")
    with path.open("rb") as stream:
        data = stream.read(_MOST_TEXT + 1)
    if len(data) > _MOST_TEXT:
        raise ValueError(f"{path} is longer than {_MOST_TEXT} bytes; expected a short text file.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not a text file in UTF-8: {error}.") from error


def some(names: Iterable[str], *, most: int = 4) -> str:
    """The first of many names in one line, for an error."""
    every = [name if len(name) <= 60 else name[:57] + "..." for name in names]
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more if every else "nothing"


def plain_name(path: Path) -> str:
    r"""A folder's name as text that can be printed, drawn and encoded everywhere.

    Bytes that are not UTF-8 become escapes such as `\xff`.
    """
    text = os.fsencode(path.name).decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def _number(value: int) -> str:
    text = str(value)
    return text if len(text) <= 12 else f"10^{len(text) - 1}"
