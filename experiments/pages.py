"""Figures of README.md and docs/*.md, written from `experiments/results/*.json`.

A page has, where figures stand, a name from `_tables.py` and what it makes of the results:

    <!-- results: calibrated cotton -->74 and 95 %<!-- /results -->

Each JSON file is what one run of a script has written, with its commit and digests of the code
that it depends on. A result is stale when a file that it depends on has changed since.

    python experiments/pages.py            # write the pages
    python experiments/pages.py --check    # compare them, list what is stale
    python experiments/pages.py --take results/table_edges/table_edges.json
"""

import argparse
import json
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._report import ROOT, digests
from experiments._tables import TABLES, Results

_OPEN, _CLOSE = "<!-- results: ", "<!-- /results -->"
_MARKED = re.compile(f"{_OPEN}(?P<words>.*?) -->(?P<text>.*?){_CLOSE}", re.DOTALL)


def pages(root: Path) -> list[Path]:
    """The pages of a checkout that may have figures."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def updated(page: Path, results: Results) -> tuple[str, list[str]]:
    """The text of a page with the figures of the results, and the names of those that differ.

    Raises:
        ValueError: if a marker is not closed or names no table, or if a result lacks a figure.
    """
    wrong = []

    def replace(match: re.Match[str]) -> str:
        name, *words = shlex.split(match["words"])
        if name not in TABLES:
            raise ValueError(f"{page}: {name!r} is none of the tables {', '.join(TABLES)}.")
        made = TABLES[name](results, *words)
        if made.startswith("|"):
            made = f"\n\n{made}\n\n"
        elif match.start() == 0 or text[match.start() - 1] == "\n":
            # Markdown takes the rest of such a line for HTML.
            raise ValueError(
                f"{page}: `{_OPEN}{match['words']}` is within a sentence, not in front."
            )
        if made != match["text"]:
            wrong.append(match["words"])
        return f"{_OPEN}{match['words']} -->{made}{_CLOSE}"

    text = page.read_text(encoding="utf-8")
    new, count = _MARKED.subn(replace, text)
    if {text.count(_OPEN), text.count(_CLOSE)} != {count}:
        raise ValueError(f"{page}: each `{_OPEN}...` needs a `{_CLOSE}` of its own.")
    return new, wrong


def disagreements(root: Path = ROOT) -> list[str]:
    """Figures of the pages that are not those of the results."""
    results = Results(root / "experiments" / "results")
    return [
        f"{page.relative_to(root)}: {words}"
        for page in pages(root)
        for words in updated(page, results)[1]
    ]


def stale(root: Path = ROOT) -> list[str]:
    """Results that are older than the code that they depend on, with the files that changed."""
    files = Results(root / "experiments" / "results").files
    now = digests({pattern for found in files.values() for pattern in found["depends"]}, root)
    lines = []
    for name, found in files.items():
        changed = [
            pattern for pattern, digest in found["depends"].items() if now[pattern] != digest
        ]
        if changed:
            more = f" and {len(changed) - 3} more" if len(changed) > 3 else ""
            lines.append(f"{name}.json: {', '.join(changed[:3])}{more}")
    return lines


def take(paths: Sequence[Path], root: Path = ROOT) -> Iterator[Path]:
    """Copies results of runs; files that `write_json` has not written are passed over."""
    for path in paths:
        text = path.read_text(encoding="utf-8")
        if {"commit", "command", "depends", "content"} <= set(json.loads(text)):
            copy = root / "experiments" / "results" / path.name
            copy.write_text(text, encoding="utf-8")
            yield copy


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Writes or checks the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="change nothing; fail if pages differ")
    parser.add_argument("--strict", action="store_true", help="fail for stale results, too")
    parser.add_argument("--take", nargs="+", type=Path, default=[], metavar="JSON")
    arguments = parser.parse_args(words)
    for copy in take(arguments.take, root):
        print(f"taken: {copy.relative_to(root)}")
    wrong, old = disagreements(root), stale(root)
    if not arguments.check:
        results = Results(root / "experiments" / "results")
        for page in pages(root):
            page.write_text(updated(page, results)[0], encoding="utf-8")
    for line in wrong:
        print(f"{'differs from' if arguments.check else 'written from'} the results: {line}")
    for line in old:
        print(f"stale: {line}")
    return int((arguments.check and bool(wrong)) or (arguments.strict and bool(old)))


if __name__ == "__main__":
    sys.exit(main())
