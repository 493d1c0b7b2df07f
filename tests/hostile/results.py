"""Results of `mvedge depth` that are damaged, as `export` and `view` read them."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from cli.scenes import write_result
from datasets.layouts import random_views, write_hci
from hostile.case import hostile
from hostile.commands import call, complaint, files

from mvedge_jax.datasets import write_pfm

_GOOD = object()
# What a report may hold in place of the light field that a result was made from.
_SOURCES: list[Any] = [
    None, 3, "here", [], {}, {"path": None}, {"path": 7}, {"path": ["a"]}, {"path": "/dev/null"},
    {"path": "SCENE"}, {"path": "SCENE", "views": "many"}, {"path": "SCENE", "views": 4},
    {"path": "SCENE", "views": None, "scale": None}, {"path": "SCENE", "unknown": 1},
    {"path": "SCENE", "views": None, "scale": -1.0, "flip_u": 0, "flip_v": 0},
    {"path": "SCENE", "swap_axes": "yes"},
]  # fmt: skip


def _result(folder: Path, source: Any = _GOOD) -> Path:
    """A result of a scene beside it, whose report may tell something else."""
    scene = write_hci(folder / "scene", random_views((3, 3, 16, 16, 3)))
    result = write_result(folder / "result", scene, np.zeros((16, 16)), xy=np.ones((3, 2)))
    if source is not _GOOD:
        if isinstance(source, dict) and source.get("path") == "SCENE":
            source = {**source, "path": str(scene)}
        (result / "report.json").write_text(json.dumps({"source": source}))
    return result


def _survives(folder: Path, codes: tuple[int, ...] = (0, 2)) -> None:
    """No command ends in anything but a result or a sentence."""
    result, before = folder / "result", files(folder)
    lines: list[tuple[object, ...]] = [
        ("export", result, folder / f"as {form}", "--to", form)
        for form in ("colmap", "nerfstudio", "ply")
    ]
    lines.append(("export", result, folder / "edges", "--to", "ply", "--points", "edges"))
    lines.append(("view", result, "--html", folder / "page.html"))
    for words in lines:
        code, _, error = call(*words)
        assert code in codes, error
        if code:
            complaint(error)
    after = files(folder)
    assert {k: after[k] for k in before} == before
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


@hostile("a whole result")
def _whole(folder: Path) -> None:
    _result(folder)
    _survives(folder, codes=(0,))


@hostile("a result of {}", {json.dumps(source): source for source in _SOURCES})
def _told(folder: Path, source: Any) -> None:
    _result(folder, source)
    _survives(folder)


def _array() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


_CONTENTS: dict[str, bytes | None] = {
    "nothing": b"",
    "no text": b"\xff\xfe\x00",
    "a list": b"[]",
    "half an object": b'{"source": ',
    "deep brackets": b"[" * 100000,
    "an endless number": b'{"source": 1' + b"0" * 5000 + b"}",
    "a pickle": b"\x80\x04\x95\x10\x00\x00\x00\x00\x00\x00\x00\x8c\x02os.",
    "a zip without end": b"PK\x03\x04" + bytes(40),
    "an array": _array(),
    "a stereo report": b'{"model": 1, "photographs": {"a": {}}}',
    "a stereo report without more": b'{"model": "/dev/null", "photographs": []}',
    "files, being a folder": None,
}  # fmt: skip
_TEXTS = tuple(_CONTENTS)
# To what holds numbers, one text is as good as another.
_NUMBERS = ("nothing", "no text", "a pickle", "a zip without end", "an array", _TEXTS[-1])
_FILES = {
    "report.json": _TEXTS, ".mvedge.json": _NUMBERS, "disparity.pfm": _NUMBERS,
    "standard_error.pfm": _NUMBERS, "points.npz": _NUMBERS, "views.h5": _NUMBERS,
}  # fmt: skip


@hostile("{} holds {}", [(name, what) for name, kinds in _FILES.items() for what in kinds])
def _spoilt(folder: Path, name: str, what: str) -> None:
    path, content = _result(folder) / name, _CONTENTS[what]
    if content is None:
        path.unlink(missing_ok=True)
        path.mkdir()
    else:
        path.write_bytes(content)
    _survives(folder)


_POINTS = {"disparity": np.zeros(3), "error": np.zeros(3), "visible": np.ones((3, 6), bool)}
_COLUMNS: dict[str, dict[str, Any]] = {
    "objects": {"xy": np.array([{}], object)},
    "one column": {"xy": np.ones((3, 2))},
    "columns of two lengths": {
        **_POINTS, "xy": np.ones((3, 2)), "disparity": np.zeros(2), "error": np.zeros(1)
    },
    "views of another grid": {**_POINTS, "xy": np.ones((3, 2)), "visible": np.ones((3, 2), bool)},
    "text": {**_POINTS, "xy": np.full((3, 2), "x"), "disparity": np.full(3, "y")},
    "places far outside and NaN": {
        **_POINTS, "xy": np.array([[1e9, -1e9], [np.nan, 0], [0, np.inf]])
    },
}  # fmt: skip


@hostile("points with {}", _COLUMNS)
def _stored(folder: Path, arrays: dict[str, Any]) -> None:
    np.savez(_result(folder) / "points.npz", **arrays)
    _survives(folder)


@hostile("a map of {}x{}", [(1, 1), (16, 17), (200, 1)])
def _sized(folder: Path, height: int, width: int) -> None:
    write_pfm(_result(folder) / "disparity.pfm", np.zeros((height, width), np.float32))
    _survives(folder)
