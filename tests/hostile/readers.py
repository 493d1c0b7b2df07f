"""Commands that read results, masks or several light fields: wrong words, and damaged results.

In-process; every case ends before anything is compiled.
"""

import io
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from datasets.layouts import random_views, save_image, write_hci
from hostile.case import Case
from hostile.commands import call, complaint
from hostile.scenes import TRUTH, hci

from mvedge_jax.datasets import write_pfm


def cases() -> Iterator[Case]:
    """All of them."""
    for words in (*_VIEW, *_EDIT, *_EXPORT, *_SEVERAL, *_OTHERS):
        yield Case("mvedge " + " ".join(map(str, words)), _refused(words))
    yield from _damaged()
    yield from _batches()


_VIEW: list[tuple[object, ...]] = [
    ("view",),
    ("view", "nowhere"),
    ("view", "MAP"),
    ("view", "MAP", "--scene", "nowhere"),
    ("view", "MAP", "--scene", "MAP"),
    ("view", "SCENE", "--html", "MAP"),
    ("view", "SCENE", "--html", "SCENE"),
    ("view", "SCENE", "--html", "nowhere/page.html"),
    ("view", "SCENE", "--html", "PAGE"),
    ("view", "SCENE", "--html", "FOLDER.html"),
    ("view", "SCENE", "--html", "FOLDER.html", "--overwrite"),
    ("view", "SCENE", "--html", "NEW", "--quality", 0),
    ("view", "SCENE", "--html", "NEW", "--quality", 101),
    ("view", "SCENE", "--html", "NEW", "--views", 4),
    ("view", "SCENE", "--html", "NEW", "--scale", "nan"),
    ("view", "SCENE", "--html", "NEW", "--other", "nowhere"),
    ("view", "SCENE", "--html", "NEW", "--other", "SCENE"),
    ("view", "SCENE", "--html", "NEW", "--other", "LARGE"),
    ("view", "SCENE", "--html", "NEW", "--superpixels", "SCENE"),
    ("view", "MAP", "--scene", "SCENE", "--html", "NEW", "--superpixels", "nowhere"),
    ("view", "MAP", "--scene", "SCENE", "--html", "NEW", "--superpixels", "LABELS"),
    ("view", "SCENE", "--html", "NEW", "--hidden", "SCENE"),
    ("view", "MAP", "--scene", "SCENE", "--html", "NEW", "--hidden", "nowhere"),
    ("view", "MAP", "--scene", "SCENE", "--html", "NEW", "--hidden", "LABELS"),
    ("view", "SCENE", "--port", -1),
    ("view", "SCENE", "--port", 70000),
    ("view", "SCENE", "--host", "nowhere.invalid"),
    ("view", "SCENE", "--host", "192.0.2.1"),
]
_EDIT: list[tuple[object, ...]] = [
    ("edit", "nowhere", "OUT", "--mask", "MASK"),
    ("edit", "SCENE", "OUT", "--mask", "MASK", "--insert", "MASK"),
    ("edit", "SCENE", "OUT", "--mask", "LABELS"),
    ("edit", "SCENE", "OUT", "--mask", "SMALL"),
    ("edit", "SCENE", "OUT", "--insert", "SCENE"),
    ("edit", "SCENE", "OUT", "--insert", "SMALL", "--at", "nan", 1),
    ("edit", "SCENE", "OUT", "--insert", "SMALL", "--disparity", "nan"),
    ("edit", "SCENE", "OUT", "--insert", "SMALL", "--disparity", "inf"),
    ("edit", "SCENE", "OUT", "--insert", "SMALL", "--slant", 0, "nan"),
    ("edit", "SCENE", "OUT", "--mask", "MASK", "--colour", 0, "nan", 0),
    ("edit", "SCENE", "OUT", "--mask", "MASK", "--colour", 0, 2, 0),
    ("edit", "SCENE", "OUT", "--mask", "MASK", "--colour", 0, 1),
    ("edit", "SCENE", "SCENE", "--mask", "MASK"),
]
_EXPORT: list[tuple[object, ...]] = [
    ("export", "SCENE", "OUT"),
    ("export", "SCENE", "OUT", "--to", "obj"),
    ("export", "SCENE", "OUT", "--to", "ply"),
    ("export", "SCENE", "OUT", "--to", "ply", "--points", "edges"),
    ("export", "nowhere", "OUT", "--to", "colmap"),
    ("export", "MAP", "OUT", "--to", "colmap"),
    ("export", "SCENE", "SCENE", "--to", "colmap"),
    ("export", "SCENE", "MAP", "--to", "colmap", "--overwrite"),
    ("export", "SCENE", "OUT", "--to", "colmap", "--camera", 0, 1, 1),
    ("export", "SCENE", "OUT", "--to", "colmap", "--camera", 1, -1, 1),
    ("export", "SCENE", "OUT", "--to", "colmap", "--camera", 1, 1, "nan"),
    ("export", "SCENE", "OUT", "--to", "colmap", "--camera", "inf", 1, 1),
]
_SEVERAL: list[tuple[object, ...]] = [
    ("batch",),
    ("batch", "SCENE"),
    ("batch", "nowhere", "OUT"),
    ("batch", "SCENE", "SCENE", "OUT"),
    ("batch", "SCENE", "MAP"),
    ("batch", "SCENE", "SCENE"),
    ("batch", "SCENE", "OUT", "--range", 1, 0),
    ("batch", "SCENE", "OUT", "--range", "nan", 1),
    ("batch", "SCENE", "OUT", "--range", "-inf", "inf"),
    ("batch", "SCENE", "OUT", "--views", 4),
    ("batch", "SCENE", "OUT", "--scale", 0),
    ("batch", "SCENE", "OUT", "--workers", -1),
    ("batch", "SCENE", "OUT", "--scheduler", "nonsense"),
    ("batch", "SCENE", "OUT", "--video", "--scheduler", "tcp://nowhere:1"),
    ("batch", "SCENE", "OUT", "--slurm", "--workers", 1),
    ("sweep", "SCENE"),
    ("sweep", "nowhere", "OUT", "--vary", "dense.trust=1:2"),
    ("sweep", "SCENE", "OUT"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.turst=1:2"),
    ("sweep", "SCENE", "OUT", "--vary", "refine.solves=1:2"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--preset", "edges"),
    ("sweep", "SCENE", "OUT", "--choose", "refine.solves=0,1"),
    ("sweep", "SCENE", "OUT", "--choose", "dense.trust=1,2"),
    ("stereo", "SCENE", "OUT", "--set", "refine.solves=0"),
    ("stereo", "SCENE", "OUT", "--set", "edges.spacing=1"),
    ("stereo", "SCENE", "OUT", "--set", "refine.solves=1", "--method", "points"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=2:1"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=0:1"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:nan"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2:3:4"),
    ("sweep", "SCENE", "OUT", "--vary", "[bold]=1:2"),
    ("sweep", "SCENE", "OUT", "--choose", "views="),
    ("sweep", "SCENE", "OUT", "--choose", "nothing=1"),
    ("sweep", "SCENE", "OUT", "--choose", "views=none"),
    ("sweep", "SCENE", "OUT", "--choose", "levels=0"),
    ("sweep", "SCENE", "OUT", "--choose", "levels=1e99"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--trials", 0),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--batch", 0),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--wave", 0),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--objective", "best"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--journal", "SCENE"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--journal", "MAP"),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--workers", -1),
    ("sweep", "SCENE", "OUT", "--vary", "dense.trust=1:2", "--scheduler", "nonsense"),
]
_OTHERS: list[tuple[object, ...]] = [
    ("stereo", "nowhere", "OUT"),
    ("stereo", "SCENE", "OUT"),
    ("stereo", "MAP", "OUT"),
    ("superpixels", "nowhere", "OUT"),
    ("superpixels", "SCENE", "OUT", "--size", "nan"),
    ("superpixels", "SCENE", "OUT", "--size", 0),
    ("superpixels", "SCENE", "OUT", "--count", 0),
    ("superpixels", "SCENE", "OUT", "--size", 5, "--pick", 8, 0),
    ("superpixels", "SCENE", "OUT", "--size", 5, "--pick", -1, 0),
    ("superpixels", "SCENE", "OUT", "--size", 5, "--colour", "nan", 0, 0),
    ("superpixels", "SCENE", "OUT", "--views", 2),
]


def _files(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def _refused(words: tuple[object, ...]) -> Any:
    def run(folder: Path) -> None:
        scene = hci(folder)
        write_pfm(folder / "map.pfm", TRUTH)
        write_pfm(folder / "large.pfm", np.pad(TRUTH, 1))
        save_image(folder / "mask.png", np.full((*TRUTH.shape, 3), 255, np.uint8))
        save_image(folder / "small.png", np.zeros((2, 2, 3), np.uint8))
        (folder / "labels").mkdir()
        np.save(folder / "labels" / "labels.npy", np.zeros((1, 2), np.float32))
        (folder / "folder.html").mkdir()
        (folder / "page.html").write_text("mine")
        places = {
            "SCENE": scene,
            "MAP": folder / "map.pfm",
            "LARGE": folder / "large.pfm",
            "MASK": folder / "mask.png",
            "SMALL": folder / "small.png",
            "LABELS": folder / "labels",
            "FOLDER.html": folder / "folder.html",
            "PAGE": folder / "page.html",
            "NEW": folder / "new.html",
            "OUT": folder / "out",
            "nowhere": folder / "nowhere",
            "nowhere/page.html": folder / "nowhere" / "page.html",
        }
        before = _files(folder)
        code, _, error = call(*(places.get(str(word), word) for word in words))
        assert "Traceback" not in error, error
        if "--help" not in error:  # wrong words are told in a frame of several lines
            complaint(error)
        assert code == 2, error
        after = _files(folder)
        assert after == before, set(after) ^ set(before)

    return run


# What a report may hold in place of the light field that a result was made from.
_SOURCES: list[Any] = [
    None, 3, "here", [], {}, {"path": None}, {"path": 7}, {"path": ["a"]}, {"path": "/dev/null"},
    {"path": "SCENE"}, {"path": "SCENE", "views": "many"}, {"path": "SCENE", "views": 4},
    {"path": "SCENE", "views": None, "scale": None}, {"path": "SCENE", "unknown": 1},
    {"path": "SCENE", "views": None, "scale": -1.0, "flip_u": 0, "flip_v": 0},
    {"path": "SCENE", "swap_axes": "yes"},
]  # fmt: skip


def _result(folder: Path, source: Any) -> Path:
    """What `mvedge depth` writes, of a scene beside it."""
    scene = write_hci(folder / "scene", random_views((3, 3, 16, 16, 3)))
    result = folder / "result"
    result.mkdir()
    if isinstance(source, dict) and source.get("path") == "SCENE":
        source = {**source, "path": str(scene)}
    (result / "report.json").write_text(json.dumps({"source": source}))
    (result / ".mvedge.json").write_text(json.dumps({"program": "mvedge_jax", "written": []}))
    write_pfm(result / "disparity.pfm", np.zeros((16, 16), np.float32))
    write_pfm(result / "standard_error.pfm", np.full((16, 16), 0.1, np.float32))
    columns = {"xy": np.ones((3, 2)), "visible": np.ones((3, 6), bool)}
    np.savez(result / "points.npz", disparity=np.zeros(3), error=np.full(3, 0.1), **columns)
    return result


_GOOD = {"path": "SCENE", "views": None, "scale": 1.0, "flip_u": False, "flip_v": False}
_EXPORTS = ("colmap", "nerfstudio", "ply")


def _array() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros(3))
    return file.getvalue()


def _damaged() -> Iterator[Case]:
    def survives(result: Path, folder: Path, *, good: bool = False) -> None:
        """No command ends in anything but a result or a sentence."""
        before = _files(folder)
        lines: list[tuple[object, ...]] = [
            ("export", result, folder / f"as {to}", "--to", to) for to in _EXPORTS
        ]
        lines.append(("view", result, "--html", folder / "page.html"))
        for words in lines:
            code, _, error = call(*words)
            assert code in ((0,) if good else (0, 2)), error
            if code:
                complaint(error)
        after = _files(folder)
        assert {k: after[k] for k in before} == before
        assert not [path for path in folder.iterdir() if path.name.startswith(".")]

    def whole(folder: Path) -> None:
        survives(_result(folder, _GOOD), folder, good=True)

    yield Case("export and view of a result", whole)
    for source in _SOURCES:

        def told(folder: Path, source=source) -> None:
            survives(_result(folder, source), folder)

        yield Case(f"export and view of a result of {json.dumps(source)}", told)
    contents: dict[str, bytes] = {
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
    }  # fmt: skip
    files = ("report.json", ".mvedge.json", "disparity.pfm", "standard_error.pfm", "points.npz",
             "views.h5")  # fmt: skip
    for name in files:
        for what, content in contents.items():

            def spoilt(folder: Path, name=name, content=content) -> None:
                result = _result(folder, _GOOD)
                (result / name).write_bytes(content)
                survives(result, folder)

            yield Case(f"export and view where {name} holds {what}", spoilt)

        def folders(folder: Path, name=name) -> None:
            result = _result(folder, _GOOD)
            (result / name).unlink(missing_ok=True)
            (result / name).mkdir()
            survives(result, folder)

        yield Case(f"export and view where {name} is a folder", folders)
    columns: dict[str, Any] = {
        "objects": {"xy": np.array([{}], object)},
        "one column": {"xy": np.ones((3, 2))},
        "columns of two lengths": {
            "xy": np.ones((3, 2)), "disparity": np.zeros(2), "error": np.zeros(1),
            "visible": np.ones((3, 6), bool),
        },
        "views of another grid": {
            "xy": np.ones((3, 2)), "disparity": np.zeros(3), "error": np.zeros(3),
            "visible": np.ones((3, 2), bool),
        },
        "text": {
            "xy": np.full((3, 2), "x"), "disparity": np.full(3, "y"), "error": np.zeros(3),
            "visible": np.ones((3, 6), bool),
        },
        "places far outside and NaN": {
            "xy": np.array([[1e9, -1e9], [np.nan, 0], [0, np.inf]]), "disparity": np.zeros(3),
            "error": np.zeros(3), "visible": np.ones((3, 6), bool),
        },
    }  # fmt: skip
    for what, arrays in columns.items():

        def stored(folder: Path, arrays=arrays) -> None:
            result = _result(folder, _GOOD)
            np.savez(result / "points.npz", **arrays)
            survives(result, folder)
            out = folder / "edges"
            code, _, error = call("export", result, out, "--to", "ply", "--points", "edges")
            assert code in (0, 2), error

        yield Case(f"export and view of points with {what}", stored)
    for shape in ((1, 1), (16, 17), (200, 1)):

        def sized(folder: Path, shape=shape) -> None:
            result = _result(folder, _GOOD)
            write_pfm(result / "disparity.pfm", np.zeros(shape, np.float32))
            survives(result, folder)

        yield Case(f"export and view of a map of {shape[0]}x{shape[1]}", sized)


def _batches() -> Iterator[Case]:
    """A light field that cannot be read stops no other, and is told."""
    for name, content in (("empty", b""), ("no picture", b"none"), ("half a picture", b"\x89PNG")):

        def run(folder: Path, content=content) -> None:
            scenes = []
            for which in ("one", "two[/old]"):
                scene = write_hci(folder / which, random_views())
                (scene / "input_Cam004.png").write_bytes(content)
                scenes.append(scene)
            out = folder / "out"
            code, said, error = call("batch", *scenes, out)
            assert code == 1, error
            assert "Traceback" not in error + said
            assert {path.name for path in out.iterdir()} == {"summary.csv", "summary.json"}
            rows = json.loads((out / "summary.json").read_text())
            text = json.dumps(rows)
            assert text.count("input_Cam004.png") == 2, text
            os.environ.pop("MVEDGE_MAX_GB", None)

        yield Case(f"batch of two light fields with a picture that is {name}", run)
