"""What griffe cannot know about this package: its exports, and how its docstrings are written."""

import ast
import re
from pathlib import Path
from typing import Any

import griffe

_EXAMPLE = re.compile(r"^Example:$", re.MULTILINE)
_SOURCE = re.compile(r"^Source:\s+(\S.*(?:\n +\S.*)*)", re.MULTILINE)


def _source(found: re.Match[str]) -> str:
    return "**Source:** " + " ".join(line.strip() for line in found[1].splitlines())


class Exports(griffe.Extension):
    """Takes `from ._x import y as y` for an export, and writes sections in one way."""

    def on_module_members(self, *, mod: griffe.Module, **kwargs: Any) -> None:
        """Lists the names that a module gives away: those of others, and its own."""
        path = mod.filepath
        if not isinstance(path, Path):
            return
        body = ast.parse(path.read_text(encoding="utf-8")).body
        names = [
            name.asname
            for node in body
            if isinstance(node, ast.ImportFrom)
            for name in node.names
            if name.asname is not None and name.asname == name.name
        ]
        own = (node.name for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef))
        if mod.exports is None and names:
            mod.exports = [*names, *(name for name in own if not name.startswith("_"))]

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Sections by the names that griffe knows."""
        docstring = obj.docstring
        if docstring is None:
            return
        text = _EXAMPLE.sub("Examples:", docstring.value)
        docstring.value = _SOURCE.sub(_source, text).rstrip()
