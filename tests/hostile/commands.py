"""Command lines and surroundings that a user may come with; in-process, nothing is compiled."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from datasets.layouts import random_views, write_hci
from hostile.case import Case
from hostile.metadata import NAMES
from hostile.scenes import TRUTH, hci

from mvedge_jax.cli import main
from mvedge_jax.datasets import write_pfm


def cases() -> Iterator[Case]:
    """All of them."""
    yield from _named()
    yield from _wrong_words()
    yield from _streams()


def call(*words: object) -> tuple[int, str, str]:
    """Runs a command line: the exit code, what it says, and what it complains about."""
    os.environ["MVEDGE_CACHE"] = "off"
    said, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
        code = main([str(word) for word in words])
    return code, said.getvalue(), complained.getvalue()


def complaint(text: str) -> str:
    """The message of an error, which is one line, the last."""
    lines = text.splitlines()
    assert lines, "no message"
    assert lines[-1].startswith("mvedge: error: "), text
    assert sum(line.startswith("mvedge: ") for line in lines) == 1, text
    assert "Traceback" not in text, text
    return lines[-1]


def _left(folder: Path) -> set[str]:
    return {item.name for item in folder.iterdir()}


def _named() -> Iterator[Case]:
    for raw in NAMES:
        name = os.fsdecode(raw)

        def good(folder: Path, name=name) -> None:
            scene = write_hci(folder / "plain", random_views(), disparity=TRUTH)
            scene = scene.rename(folder / name)
            write_pfm(folder / "map.pfm", TRUTH)
            code, _, error = call("eval", folder / "map.pfm", scene, "--crop", 1)
            assert code == 0, error

        yield Case(f"eval of a scene called {raw[:40]!r}", good)

        def damaged(folder: Path, name=name) -> None:
            scene = write_hci(folder / "plain", random_views())
            (scene / "input_Cam004.png").write_bytes(b"no picture")
            scene = scene.rename(folder / name)
            code, _, error = call("depth", scene, folder / "out")
            assert code == 2, error
            message = complaint(error)
            assert "input_Cam004.png" in message
            assert message.isprintable()
            if name.isprintable():
                assert name in message, f"{name!r} is not in {message!r}"
            assert _left(folder) == {name}

        yield Case(f"depth of a damaged scene called {raw[:40]!r}", damaged)

        def into(folder: Path, name=name) -> None:
            if len(name) > 100:
                return
            scene = hci(folder)
            write_pfm(folder / "map.pfm", TRUTH)
            out = folder / name
            out.write_text("mine")
            code, _, error = call("eval", folder / "map.pfm", scene, "--out", out, "--crop", 1)
            assert code == 2, error
            complaint(error)
            assert out.read_text() == "mine"
            assert _left(folder) == {"scene", "map.pfm", name}

        yield Case(f"OUT is a file called {raw[:40]!r}", into)


def _wrong_words() -> Iterator[Case]:
    lines: list[tuple[object, ...]] = [
        ("eval", "MAP", "SCENE", "--crop", -1),
        ("eval", "MAP", "SCENE", "--crop", 10**9),
        ("eval", "nowhere.pfm", "SCENE"),
        ("eval", "MAP", "nowhere"),
        ("eval", "SCENE", "MAP"),
        ("depth", "SCENE", "SCENE"),
        ("depth", "SCENE", "SCENE/inside"),
        ("depth", "SCENE", "."),
        ("depth", "SCENE", "OUT", "--views", 4),
        ("depth", "SCENE", "OUT", "--views", -1),
        ("depth", "SCENE", "OUT", "--preset", "edges", "--all-views"),
        ("depth", "SCENE", "OUT", "--set", "smoothness.color"),
        ("depth", "SCENE", "OUT", "--set", "smoothness.colour=1"),
        ("depth", "SCENE", "OUT", "--set", "smoothness.color=nan"),
        ("depth", "SCENE", "OUT", "--set", "smoothness.color=[red]"),
        ("depth", "SCENE", "OUT", "--set", "smoothness=1"),
        ("depth", "SCENE", "OUT", "--set", "refine.solves=0"),
        ("depth", "SCENE", "OUT", "--set", "refine.solves=1e400"),
        ("depth", "SCENE", "OUT", "--set", "__class__.__name__=1"),
        ("depth", "SCENE", "OUT", "--set", "refine..solves=1"),
        ("batch", "SCENE", "OUT", "--set", "refine.solves=0"),
        ("depth", "SCENE", "OUT", "--model", "nowhere"),
        ("depth", "SCENE", "OUT", "--model", "MAP"),
        ("depth", "SCENE", "OUT", "--model", "/dev/zero"),
        ("learn", "OUT", "--what", "smoothness.colour"),
        ("learn", "OUT", "--model", "MAP"),
        ("learn", "OUT", "--rate", "nan"),
        ("learn", "OUT", "--views", 4),
        ("learn", "OUT", "--size", 0),
        ("learn", "OUT", "--range", 1, 0),
        ("learn", "OUT", "--range", "nan", "nan"),
        ("learn", "OUT", "--random", -1),
        ("learn", "OUT", "--size", 8, "--views", 3, "--steps", 0),
        ("learn", "OUT", "--size", 8, "--views", 3, "--prior", "nan"),
        ("learn", "OUT", "--size", 8, "--views", 3, "--limit", "nan"),
        ("learn", "SCENE", "OUT", "--validation", 1),
        ("learn", "nowhere", "OUT"),
        ("depth", "SCENE", "OUT", "--scale", 0),
        ("depth", "SCENE", "OUT", "--scale", "nan"),
        ("depth", "SCENE", "OUT", "--scale", "inf"),
        ("depth", "SCENE", "OUT", "--scale", "1e-320"),
        ("info", "SCENE", "--scale", "1e-320"),
        ("depth", "SCENE", "OUT", "--range", 1, 0),
        ("depth", "SCENE", "OUT", "--range", "nan", "nan"),
        ("depth", "SCENE", "OUT", "--range", "-inf", "inf"),
        ("depth", "nowhere", "OUT"),
        ("depth", "x[/old]", "OUT"),
        ("eval", "MAP", "[bold]x[/red]"),
        ("depth", "MAP", "OUT"),
        ("depth", "/dev/zero", "OUT"),
        ("depth", "SCENE", "OUT", "--max-gb", "nan"),
        ("depth", "SCENE", "OUT", "--max-gb", "much"),
        ("depth", "SCENE", "OUT", "--max-gb", "1e-9"),
        ("edges", "SCENE", "SCENE"),
        ("edges", "SCENE", "OUT", "--scale", 3),
        ("edges", "nowhere", "OUT"),
        ("views", "nowhere", "OUT"),
        ("views", "SCENE", "OUT", "--views", 2),
        ("optimize", "SCENE", "OUT", "--iterations", 0),
        ("optimize", "SCENE", "OUT", "--grow-points", 3),
        ("optimize", "SCENE", "OUT", "--features", "vgg16"),
        ("optimize", "SCENE", "OUT", "--features", "vgg16", "--vgg16", "nowhere"),
        ("optimize", "SCENE", "OUT", "--features", "vgg16", "--vgg16", "MAP"),
        ("optimize", "SCENE", "OUT", "--state", "nowhere"),
        ("optimize", "SCENE", "OUT", "--state", "MAP"),
        ("optimize", "SCENE", "OUT", "--state", "/dev/zero"),
        ("edit", "SCENE", "OUT"),
        ("edit", "SCENE", "OUT", "--mask", "nowhere"),
        ("render", "nothing", "OUT"),
        ("render", "demo", "OUT", "--views", 4),
        ("render", "demo", "OUT", "--size", 0, 0),
        ("render", "demo", "OUT", "--vignette", 2),
        ("render", "demo", "OUT", "--baseline", 0),
        ("render", "demo", "OUT", "--baseline", "nan"),
        ("render", "demo", "OUT", "--vignette", 0.4, "--gain", "nan"),
        ("demo", "OUT", "--views", 1),
        ("demo", "OUT", "--size", 3, 3),
        ("info", "nowhere"),
        ("info", "MAP"),
        ("info", "SCENE", "--views", 2),
    ]
    for words in lines:

        def run(folder: Path, words=words) -> None:
            scene = hci(folder)
            write_pfm(folder / "map.pfm", TRUTH)
            before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
            places = {"MAP": folder / "map.pfm", "SCENE": scene, "OUT": folder / "out"}
            places |= {"SCENE/inside": scene / "inside", "nowhere": folder / "nowhere"}
            code, _, error = call(*(places.get(str(word), word) for word in words))
            os.environ.pop("MVEDGE_MAX_GB", None)
            assert code == 2, error
            complaint(error)
            after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
            assert after == before, set(after) ^ set(before)

        yield Case("mvedge " + " ".join(map(str, words)), run)


class _Broken(io.StringIO):
    """A stream that nobody reads, or a full disk."""

    def __init__(self, error: OSError):
        super().__init__()
        self.error = error

    def write(self, text: str, /) -> int:
        raise self.error


def _streams() -> Iterator[Case]:
    for error in (BrokenPipeError(32, "Broken pipe"), OSError(28, "No space left on device")):

        def run(folder: Path, error=error) -> None:
            scene = hci(folder)
            write_pfm(folder / "map.pfm", TRUTH)
            os.environ["MVEDGE_CACHE"] = "off"
            words = ["eval", folder / "map.pfm", scene, "--crop", 1]
            complained = io.StringIO()
            with (
                contextlib.redirect_stdout(_Broken(error)),
                contextlib.redirect_stderr(complained),
            ):
                assert main([str(word) for word in words]) == 0
                sys.stdout.close()  # what takes the place of the broken one

        yield Case(f"standard output: {error}", run)
    for encoding in ("ascii", "latin-1", "cp1252", "utf-16"):

        def narrow(folder: Path, encoding=encoding) -> None:
            scene = write_hci(folder / "plain", random_views(), disparity=TRUTH)
            scene = scene.rename(folder / "日本 \u2028 café")
            write_pfm(folder / "map.pfm", np.pad(TRUTH, 1))
            stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
            with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
                assert main(["eval", str(folder / "map.pfm"), str(scene)]) == 2

        yield Case(f"a terminal in {encoding}", narrow)
