"""Figures that others publish, as `published.json` has them; what is not there is not printed."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FILE = Path(__file__).resolve().parent / "published.json"


def published(table: str, **where: str) -> list[dict[str, Any]]:
    """Rows of a table of the thesis that have the values of `where`.

    Args:
        table: its number, such as "6.1".
        **where: the columns to look at and what they should have, such as `scene="cotton"`.
    """
    tables = json.loads(FILE.read_text(encoding="utf-8"))["tables"]
    if table not in tables:
        raise ValueError(f"`table` must be one of {', '.join(tables)}, got {table!r}.")
    return list(_rows(tables[table]["rows"], where))


def authors_program(**where: str) -> list[dict[str, Any]]:
    """What the authors' program scores, run by us: rows that have the values of `where`."""
    content = json.loads(FILE.read_text(encoding="utf-8"))
    return list(_rows(content["authors' program"]["rows"], where))


def _rows(rows: list[dict[str, Any]], where: dict[str, str]) -> Iterator[dict[str, Any]]:
    for row in rows:
        if all(row[name] == value for name, value in where.items()):
            yield row
