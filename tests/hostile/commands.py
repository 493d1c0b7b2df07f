"""Command lines in this process, in surroundings that a user may come with."""

import contextlib
import io
import json
import os
import sys
from pathlib import Path

import numpy as np
from datasets.layouts import random_views, write_hci
from hostile.case import hostile
from hostile.scenes import TRUTH, hci

from mvedge_jax.cli import main
from mvedge_jax.datasets import write_pfm


def call(*words: object) -> tuple[int, str, str]:
    """Runs a command line: the exit code, what it says, and what it complains about."""
    os.environ["MVEDGE_CACHE"] = "off"
    said, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        code = main([str(word) for word in words])
    os.environ.pop("MVEDGE_MAX_GB", None)
    return code, said.getvalue(), complained.getvalue()


def complaint(text: str) -> str:
    """The message of an error, which is one line, the last."""
    lines = text.splitlines()
    assert lines, "no message"
    assert lines[-1].startswith("mvedge: error: "), text
    assert sum(line.startswith("mvedge: ") for line in lines) == 1, text
    assert "Traceback" not in text, text
    return lines[-1]


def files(folder: Path) -> dict[str, bytes]:
    """All files in a folder, with what they hold."""
    return {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class _Broken(io.StringIO):
    """A stream that nobody reads, or a full disk."""

    def __init__(self, error: OSError):
        super().__init__()
        self.error = error

    def write(self, text: str, /) -> int:
        raise self.error


@hostile(
    "standard output: {}",
    [BrokenPipeError(32, "Broken pipe"), OSError(28, "No space left on device")],
)
def _stream(folder: Path, error: OSError) -> None:
    scene = hci(folder)
    write_pfm(folder / "map.pfm", TRUTH)
    os.environ["MVEDGE_CACHE"] = "off"
    words = ["eval", folder / "map.pfm", scene, "--crop", 1]
    complained = io.StringIO()
    with contextlib.redirect_stdout(_Broken(error)), contextlib.redirect_stderr(complained):
        assert main([str(word) for word in words]) == 0
        sys.stdout.close()  # what takes the place of the broken one


@hostile("a terminal in {}", ["ascii", "latin-1", "cp1252", "utf-16"])
def _narrow(folder: Path, encoding: str) -> None:
    scene = write_hci(folder / "plain", random_views(), disparity=TRUTH)
    scene = scene.rename(folder / "日本 \u2028 café")
    write_pfm(folder / "map.pfm", np.pad(TRUTH, 1))
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
        assert main(["eval", str(folder / "map.pfm"), str(scene)]) == 2


@hostile(
    "batch of two light fields with a picture that is {}",
    {"empty": b"", "no picture": b"none", "half a picture": b"\x89PNG"},
)
def _batch(folder: Path, content: bytes) -> None:
    """A light field that cannot be read stops no other, and is told."""
    scenes = [write_hci(folder / which, random_views()) for which in ("one", "two[/old]")]
    for scene in scenes:
        (scene / "input_Cam004.png").write_bytes(content)
    out = folder / "out"
    code, said, error = call("batch", *scenes, out)
    assert code == 1, error
    assert "Traceback" not in error + said
    assert {path.name for path in out.iterdir()} == {"summary.csv", "summary.json"}
    text = json.dumps(json.loads((out / "summary.json").read_text()))
    assert text.count("input_Cam004.png") == 2, text
