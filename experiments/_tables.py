"""The tables and figures of the pages, by name, as Markdown made of `results/*.json`.

`pages.py` puts them between its markers. Each takes the results and the words behind its name.
"""

import json
from collections.abc import Callable, Sequence
from decimal import ROUND_HALF_UP, Decimal
from functools import cached_property
from pathlib import Path
from typing import Any

from experiments._published import authors_program, published

Row = dict[str, Any]


class Results:
    """What the scripts found, as the JSON files of a folder have it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def files(self) -> dict[str, dict[str, Any]]:
        """Every result by the name of its file."""
        paths = sorted(self.folder.glob("*.json"))
        return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths}

    def rows(self, name: str, part: str = "rows") -> list[Row]:
        """The rows of a result, or those of a part of it."""
        if name not in self.files:
            raise ValueError(f"{self.folder} has no {name}.json; it has {', '.join(self.files)}.")
        content = self.files[name]["content"]
        return content[part] if isinstance(content, dict) else content

    def row(self, name: str, part: str = "rows", **where: str) -> Row:
        """The one row that has the values of `where`."""
        found = [
            row
            for row in self.rows(name, part)
            if all(row.get(column) == value for column, value in where.items())
        ]
        if len(found) != 1:
            raise ValueError(f"{name}.json has {len(found)} rows with {where}; expected one.")
        return found[0]


SCORES = ("MSE*100", "Q25*100", "BP(.01)", "BP(.03)", "BP(.07)")
_HEADS = ("MSE x 100", "Q25 x 100", *SCORES[2:])
# Of `table_edges.py`: how the pages call its rows.
_README = {
    "thesis": "preset `thesis` (Ch. 4 and 6 as printed, and corrected)",
    "edges": "preset `edges`: the edges alone",
    "edges without transmittance": "the same without transmittance",
    "edges without sides": "the same without sides",
    "full without edges": "preset `full` without edges",
    "full": "preset `full`",
}
_PARTS = {
    "thesis": '`"thesis"`',
    "edges": '`"edges"`',
    "edges without transmittance": '`"edges"`, `labels=NearestLabels()`',
    "edges without sides": '`"edges"`, `sides=NoSides()`',
    "full without edges": '`"full"`, `labels.weight` 0',
    "full": '`"full"`',
}


def _rounded(value: float, digits: int) -> str:
    """With halves rounded up, as readers do with what is printed elsewhere."""
    unit = Decimal(1).scaleb(-digits)
    return str(Decimal(str(value)).quantize(unit, ROUND_HALF_UP))


def _cells(row: Row, columns: Sequence[str]) -> list[str]:
    """Scores as text: errors with three digits at most, shares of pixels in per cent."""
    cells = []
    for column in columns:
        value = row.get(column)
        if value is None:
            cells.append("")
        elif column.startswith("BP"):
            cells.append(f"{_rounded(value, 1)} %")
        else:
            cells.append(_rounded(value, 2 if value < 10 else 1))
    return cells


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line).strip() + " |" for line in lines)


# The columns of `table_7_2.py` that are `SCORES`.
_MODEL: dict[str, str] = dict(
    zip(("mse", "q25", "bad_01", "bad_03", "bad_07"), SCORES, strict=True)
)


def accuracy(results: Results) -> str:
    """README, docs/accuracy.md: two scenes, full frame, ours beside others."""

    def ours(scene: str, method: str) -> Row:
        return results.row("table_6_1", scene=scene, method=method)

    def optimized(scene: str, method: str) -> Row:
        row = results.row("table_7_2", scene=f"hci/{scene}", method=method)
        return {_MODEL.get(column, column): value for column, value in row.items()}

    def peer(scene: str, method: str) -> Row:
        rows = results.rows("peer_maps")
        return next((r for r in rows if (r["scene"], r["method"]) == (scene, method)), {})

    def authors(scene: str, method: str) -> Row:
        return authors_program(scene=scene, method=method)[0]

    def thesis(scene: str, method: str) -> Row:
        # The same chain: squared errors of the later table, what that lacks of the earlier one.
        both = (("6.1", "Ours"), ("7.2", method))
        rows = [row for table, m in both for row in published(table, scene=scene, method=m)]
        return {column: value for row in rows for column, value in row.items()}

    more = f"{optimized('cotton', 'after')['seconds']:.0f} more, compilation included"
    lines = (
        ("`depth`, preset `full`", ours, "ours", _seconds(results, "full")),
        ('the same, `views="all"`', ours, "ours, all views", _seconds(results, "all")),
        ("`depth`, then `optimize_edges`", optimized, "after", more),
        ("EPINET (learned; without 11 px of border)", peer, "EPINET", ""),
        ("FastLFnet (learned)", peer, "FastLFnet", ""),
        ("SPO", peer, "SPO", ""),
        ("the authors' code", authors, "authors' program", ""),
        (
            "dissertation, Ch. 6 (Tab. 6.1 and 7.2)",
            thesis,
            "Ours-N",
            f"{published('6.1', scene='cotton', method='Ours')[0]['seconds']:.0f} (16 cores)",
        ),
    )
    few = ("MSE*100", "BP(.03)", "BP(.07)")
    head = (f"cotton: {_HEADS[0]}", *_HEADS[1:], f"backgammon: {_HEADS[0]}", *few[1:], "seconds")
    return _table(
        ("", *head),
        [
            (
                title,
                *_cells(find("cotton", method), SCORES),
                *_cells(find("backgammon", method), few),
                seconds,
            )
            for title, find, method, seconds in lines
        ],
    )


def _seconds(results: Results, stage: str) -> str:
    row = results.row("times", stage=stage)
    return f"{row['median s']:.1f}, first call {row['first s']:.0f}"


def views(results: Results) -> str:
    """docs/choosing.md: what labels from more views cost."""
    crosshair, every = (_seconds(results, stage) for stage in ("full", "all"))
    return _table(
        ("`views=`", "labels are measured in", "seconds (README)"),
        [
            ('`"crosshair"` (default)', "the center row and column of views", crosshair),
            (
                '`"all"`',
                "these, and in two more solves at the end in all views, but beside depth steps",
                every,
            ),
        ],
    )


def times(results: Results) -> str:
    """docs/compile.md: seconds and memory of calls."""
    titles = {
        "full": '`depth`, preset `"full"`',
        "all": 'the same, `views="all"`',
        "gradient": "value and gradient in all numbers and the views",
    }
    lines = []
    for stage, title in titles.items():
        row = results.row("times", stage=stage)
        memory = f", {row['peak MiB'] / 1024:.1f} GiB" if "peak MiB" in row else ""
        lines.append((title, f"{row['first s']:.0f} s", f"{row['median s']:.1f} s{memory}"))
    return _table(("", "first call", "later calls"), lines)


def sizes(results: Results) -> str:
    """README: seconds and memory by size, beside peers in the same run."""
    found = results.rows("sizes")

    def line(title: str, *cells: tuple[str, str, int]) -> tuple[str, ...]:
        """Of every size; each cell has a form, the column of the result and its digits."""

        def of(row: Row) -> str:
            texts = [
                form.format(_rounded(row[column], digits))
                for form, column, digits in cells
                if row.get(column) is not None
            ]
            return "".join(texts)

        return title, *map(of, found)

    return _table(
        ("", *(f"{row['px']:.0f} px" for row in found)),
        [
            line(
                "first call, s (from the cache)", ("{}", "first s", 0), (" ({})", "from cache s", 1)
            ),
            line("later calls, s", ("{}", "warm s", 2)),
            line("memory, GiB", ("{}", "peak GiB", 1)),
            line("pixels above 0.07 px", ("{} %", "BP(.07)", 1)),
            line("value and gradient, later calls, s", ("{}", "gradient warm s", 1)),
            line("their memory, GiB", ("{}", "gradient peak GiB", 1)),
            line("settings a second, in one call", ("{}", "settings per s", 1)),
            line(
                "plane sweep, s (pixels above 0.07 px)",
                ("{}", "sweep s", 2),
                (" ({} %)", "sweep BP(.07)", 0),
            ),
            line(
                "OpenCV's SGBM, two views, s (the same)",
                ("{}", "SGBM s", 3),
                (" ({} %)", "SGBM BP(.07)", 0),
            ),
            line("one diffusion, s (PyAMG)", ("{}", "diffusion s", 3), (" ({})", "PyAMG s", 2)),
        ],
    )


def curves(results: Results) -> str:
    """docs/compile.md: seconds and memory by number of views and by range."""
    # Both curves have one point in common.
    rows = {(row["views"], row["range px"]): row for row in results.rows("curves")}
    return _table(
        ("views", "range, px per view step", "first call", "later calls"),
        [
            (
                f"{row['views']:.0f}x{row['views']:.0f}",
                f"{row['range px']:.1f}",
                f"{row['first s']:.0f} s",
                f"{row['warm s']:.2f} s, {row['peak GiB']:.1f} GiB",
            )
            for row in rows.values()
        ],
    )


def machines(results: Results) -> str:
    """docs/sweeps.md: many light fields on a cluster."""
    return _table(
        ("workers", "killed", "light fields a second", "results", "lost", "estimated again"),
        [
            (
                f"{row['workers']:.0f}",
                f"{row['killed']:.0f}",
                f"{row['light fields per s']:.1f} ({row['ratio to one worker']:.2f} times)",
                f"{row['results']:.0f}",
                f"{row['lost']:.0f}",
                f"{row['estimated twice']:.0f}",
            )
            for row in results.rows("batch_machines")
        ],
    )


def gradient(results: Results) -> str:
    """README, in a sentence: seconds and memory of value and gradient."""
    row = results.row("times", stage="gradient")
    first = f"{row['first s']:.0f} s on the first call"
    return f"{row['median s']:.0f} s, {first}, and {row['peak MiB'] / 1024:.1f} GiB"


def edges(results: Results) -> str:
    """docs/accuracy.md: presets on cotton, and their mean over 13 scenes."""
    few = ("MSE*100", *SCORES[2:])
    lines = [
        (
            title,
            *_cells(results.row("table_edges", scene="cotton", method=method), few),
            *_cells(results.row("table_edges", "summary", scene="mean", method=method), SCORES),
        )
        for method, title in _README.items()
    ]
    return _table(("", f"cotton: {_HEADS[0]}", *few[1:], f"mean: {_HEADS[0]}", *_HEADS[1:]), lines)


def parts(results: Results) -> str:
    """docs/parts.md: mean and worst of 13 scenes."""
    lines = [
        (
            title,
            *(
                cell
                for what in ("mean", "worst")
                for cell in _cells(
                    results.row("table_edges", "summary", scene=what, method=method), SCORES
                )
            ),
        )
        for method, title in _PARTS.items()
    ]
    head = [f"{what}: {_HEADS[0]}" for what in ("mean", "worst")]
    return _table(("", head[0], *_HEADS[1:], head[1], *_HEADS[1:]), lines)


def learned(results: Results) -> str:
    """docs/learned.md: preset `learned` beside `full`, scene by scene."""
    columns = ("MSE*100", "BP(.01)", "BP(.03)", "BP(.07)")
    rows = results.rows("table_learned")
    places = [(row["scene"], "rows") for row in rows if row["method"] == "full"]
    lines = []
    for scene, part in [*places, ("mean", "summary"), ("worst", "summary")]:
        before, after = (
            _cells(results.row("table_learned", part, scene=scene, method=method), columns)
            for method in ("full", "learned")
        )
        pairs = zip(before, after, strict=True)
        lines.append((scene, *(f"{a.removesuffix(' %')} → {b}" for a, b in pairs)))
    return _table(("`full` → `learned`", _HEADS[0], *columns[1:]), lines)


def scores(results: Results, name: str, scene: str, method: str, *columns: str) -> str:
    """In a sentence: scores of a row, by the names of their columns."""
    part = "summary" if scene in ("mean", "worst") else "rows"
    return ", ".join(_cells(results.row(name, part, scene=scene, method=method), columns))


def step(results: Results, method: str) -> str:
    """docs/differences.md: MSE x 100 and BP(.07) of cotton by a row of `thesis_steps.py`."""
    return scores(results, "thesis_steps", "cotton", method, "MSE*100", "BP(.07)")


def program(results: Results, scene: str) -> str:
    """In a sentence: all scores of the authors' program on a scene."""
    del results  # it is none of ours
    return ", ".join(_cells(authors_program(scene=scene)[0], SCORES))


_WITHIN = ("map within one %", "map within two %")


def calibrated(results: Results, scene: str) -> str:
    """In a sentence: per cent of a map within one and within two standard errors."""
    one, two = (results.row("calibration", scene=scene)[column] for column in _WITHIN)
    return f"{one:.0f} and {two:.0f} %"


def calibration(results: Results) -> str:
    """docs/accuracy.md: per cent of the map within one and within two standard errors."""
    return _table(
        ("scene", "within one standard error", "within two"),
        [
            (row["scene"], *(f"{row[column]:.0f} %" for column in _WITHIN))
            for row in results.rows("calibration")
            if row["scene"] != "mean"
        ],
    )


def codec(results: Results) -> str:
    """docs/codec.md: bytes at equal errors."""
    return _table(
        ("map", "error (root mean square, px)", "bytes", "PNG", "JPEG 2000"),
        [
            (
                row["scene"],
                f"{row['rms error px']:.4f}" if row["rms error px"] >= 5e-5 else "< 0.0001",
                *(f"{row[column]:.0f}" for column in ("bytes", "PNG bytes", "JPEG 2000 bytes")),
            )
            for row in results.rows("codec", "at equal error")
        ],
    )


def beside(results: Results, scene: str) -> str:
    """docs/results.md: all that is known of a scene, ours, published and scored by us."""
    known = [
        *(("`table_6_1.py`", row) for row in results.rows("table_6_1")),
        *(("`table_edges.py`", row) for row in results.rows("table_edges")),
        *(("published map", row) for row in results.rows("peer_maps")),
        *(("run by us", row) for row in authors_program()),
        *((f"thesis, Tab. {table}", row) for table in ("6.1", "7.2") for row in published(table)),
    ]
    inner = ("MSE*100 crop 15", "BP(.07) crop 15")
    return _table(
        ("method", "from", *_HEADS, f"inside: {_HEADS[0]}", "BP(.07)"),
        [
            (row["method"], source, *_cells(row, (*SCORES, *inner)))
            for source, row in known
            if row["scene"] == scene
        ],
    )


def origins(results: Results) -> str:
    """docs/results.md: where each file comes from."""
    return _table(
        ("file", "command", "commit", "date", "cores", "remark"),
        [
            (
                f"`{name}.json`",
                f"`{found['command']}`",
                found["commit"],
                found["date"][:10],
                str(found.get("environment", {}).get("cores", "")),
                found.get("source", ""),
            )
            for name, found in results.files.items()
        ],
    )


TABLES: dict[str, Callable[..., str]] = {
    make.__name__: make
    for make in (
        accuracy, edges, learned, parts, views, times, sizes, curves, machines, gradient, scores,
        step, program, calibrated, calibration, codec, beside, origins,
    )
}  # fmt: skip
