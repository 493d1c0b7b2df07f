"""Names of folders that some program or other stumbles over."""

import os
from pathlib import Path

import pytest
from datasets.layouts import random_views, write_hci
from hostile.case import hostile
from hostile.commands import call, complaint
from hostile.scenes import TRUTH

from mvedge_jax.datasets import load_light_field, write_pfm

_NAMES = [
    b"[bold]", b"[red", b":smile:", b"[link=x]y", b"a\nb", b"a\x1b[31mb",
    b"a b",
    b"-x", b"--debug", b"$x^", b"$", b"%(x)s", b"{0}", b"\xff\xfe", b"caf\xe9", "日本".encode(),
    "\u202egnp".encode(), b"x" * 200, b"'", b'"', b"`", b"*", b"?", b"#", b"~", b"\\", b"%s%n",
]  # fmt: skip


@hostile("a scene called {!r:.42}", _NAMES)
def _good(folder: Path, raw: bytes) -> None:
    scene = write_hci(folder / "plain", random_views(), disparity=TRUTH)
    scene = scene.rename(folder / os.fsdecode(raw))
    loaded = load_light_field(scene)
    assert loaded.name
    loaded.name.encode("utf-8")
    write_pfm(folder / "map.pfm", TRUTH)
    code, _, error = call("eval", folder / "map.pfm", scene, "--crop", 1)
    assert code == 0, error


@hostile("a damaged scene called {!r:.42}", _NAMES)
def _damaged(folder: Path, raw: bytes) -> None:
    name = os.fsdecode(raw)
    scene = write_hci(folder / "plain", random_views())
    (scene / "input_Cam004.png").write_bytes(b"no picture")
    scene = scene.rename(folder / name)
    # What a name holds stays in it; the command escapes it.
    with pytest.raises(ValueError, match="input_Cam004.png"):
        load_light_field(scene)
    code, _, error = call("depth", scene, folder / "out")
    assert code == 2, error
    message = complaint(error)
    assert "input_Cam004.png" in message
    assert message.isprintable()
    if name.isprintable():
        assert name in message, f"{name!r} is not in {message!r}"
    assert [item.name for item in folder.iterdir()] == [name]
