"""Configurations, headers of maps, names: whatever can be written, is."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from datasets.layouts import (
    CONFIGURATION,
    random_views,
    write_hci,
    write_stanford,
)
from hostile.case import Case, mutated, refuses, survives
from hostile.scenes import TRUTH, hci

from experiments.peers.photographs import read_colmap_depth
from mvedge_jax.datasets import load_ground_truth, load_light_field, read_pfm, write_pfm

# Names of folders that some program or other stumbles over.
NAMES = [
    b"[bold]", b"[red", b":smile:", b"[link=x]y", b"a\nb", b"a\x1b[31mb",
    b"a b",
    b"-x", b"--debug", b"$x^", b"$", b"%(x)s", b"{0}", b"\xff\xfe", b"caf\xe9", "日本".encode(),
    "\u202egnp".encode(), b"x" * 200, b"'", b'"', b"`", b"*", b"?", b"#", b"~", b"\\", b"%s%n",
]  # fmt: skip


def cases() -> Iterator[Case]:
    """All of them."""
    yield from _configurations()
    yield from _positions()
    yield from _maps()
    yield from _colmap_maps()
    yield from _names()


def _configurations() -> Iterator[Case]:
    plain = CONFIGURATION.format(width=8, height=6, columns=3, rows=3)

    def configured(text: str | bytes, folder: Path) -> Path:
        scene = write_hci(folder / "scene", random_views())
        data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogateescape")
        (scene / "parameters.cfg").write_bytes(data)
        return scene

    keys = {
        "num_cams_x": "3",
        "num_cams_y": "3",
        "image_resolution_x_px": "8",
        "image_resolution_y_px": "6",
        "focal_length_mm": "100.0",
        "sensor_size_mm": "35.0",
        "baseline_mm": "25.0",
        "focus_distance_m": "4.25",
        "disp_min": "-1.5",
        "disp_max": "1.25",
    }
    for key, value in keys.items():
        for bad in ("nan", "inf", "-inf", "1e999", "x", "", "1,5", "0x10", "-0", "-3", "1e9"):

            def run(folder: Path, key=key, value=value, bad=bad) -> None:
                assert f"{key} = {value}" in plain
                scene = configured(plain.replace(f"{key} = {value}", f"{key} = {bad}"), folder)
                survives(lambda: load_light_field(scene), "parameters.cfg")

            yield Case(f"{key} = {bad!r}", run)
    for cameras in ("1000000000", "30000", "101", "9" * 400):

        def many(folder: Path, cameras=cameras) -> None:
            text = plain.replace("num_cams_x = 3", f"num_cams_x = {cameras}")
            scene = configured(text.replace("num_cams_y = 3", f"num_cams_y = {cameras}"), folder)
            refuses(lambda: load_light_field(scene), "parameters.cfg")

        yield Case(f"{cameras[:12]} x {cameras[:12]} cameras", many)

    def marked(folder: Path) -> None:
        scene = configured(b"\xef\xbb\xbf" + plain.encode(), folder)
        assert load_light_field(scene).camera is not None

    yield Case("a byte order mark", marked)
    texts: dict[str, str | bytes] = {
        "UTF-16": plain.encode("utf-16"),
        "Latin 1": "[meta]\nscene = caf\xe9\n".encode("latin-1"),
        "no sections": "a = 1\n" * 5000,
        "zeros": bytes(4000),
        "noise": bytes(range(256)) * 16,
        "one long line": "x" * 900_000,
        "two megabytes": "# comment\n" * 200_000,
        "duplicates": plain + plain,
        "interpolation": plain + "evil = %(evil)s ${evil}\n",
        "empty": "",
    }
    for name, text in texts.items():

        def odd(folder: Path, text=text) -> None:
            scene = configured(text, folder)
            survives(lambda: load_light_field(scene), "parameters.cfg")

        yield Case(f"parameters.cfg: {name}", odd)
    for target in ("/dev/zero", "/dev/urandom", "/dev/stdin", "fifo", "folder", "nothing", "loop"):

        def linked(folder: Path, target=target) -> None:
            scene = write_hci(folder / "scene", random_views())
            path = scene / "parameters.cfg"
            path.unlink()
            if target == "fifo":
                os.mkfifo(path)
            elif target == "folder":
                path.mkdir()
            else:
                path.symlink_to(path if target == "loop" else target)
            refuses(lambda: load_light_field(scene), "parameters.cfg")

        yield Case(f"parameters.cfg is {target}", linked)


def _positions() -> Iterator[Case]:
    for key in ("positions_x", "positions_y"):
        for bad in ("nan", "inf", "1e999", "x", "", "1,5", "0", "9" * 400):
            text = CONFIGURATION.format(width=8, height=6, columns=3, rows=3)
            others = {"positions_x": "-1 0 1 " * 3, "positions_y": "-1 -1 -1 0 0 0 1 1 1"}
            others[key] = others[key].replace("1", bad, 1)
            lines = "".join(f"{name} = {value}\n" for name, value in others.items())

            text = text.replace("[meta]", f"{lines}\n[meta]")

            def told(folder: Path, text=text) -> None:
                scene = write_hci(folder / "scene", random_views(), settings=False)
                (scene / "parameters.cfg").write_text(text)
                refuses(lambda: load_light_field(scene), "scene")

            yield Case(f"{key} with {bad[:9]!r}", told)
    whole = "".join(f"{v} {u} {u - 1} {v - 1}\n" for v in range(3) for u in range(3))
    for bad in (
        b"", b"\xff\xfe", b"0 0", b"0 0 nan 0", b"0 0 1e999 0", b"-1 0 0 0", b"1e300 0 0 0",
        b"0 0 0 0\n0 0 0 0", b"0 0 0 0\n0 1 0 0\n0 2 0 0", b"0 0 0 0 " * 200_000,
        whole.replace("-1", "5").encode(), whole.replace("0 0 -1", "0 0 -1e9").encode(),
    ):  # fmt: skip

        def filed(folder: Path, bad=bad) -> None:
            scene = write_hci(folder / "scene", random_views())
            (folder / "positions.txt").write_bytes(bad)
            refuses(
                lambda: load_light_field(scene, positions=folder / "positions.txt"),
                "",
            )

        yield Case(f"positions {bad[:24]!r}", filed)
    for special in ("/dev/zero", "/dev/null", "."):

        def device(folder: Path, special=special) -> None:
            scene = write_hci(folder / "scene", random_views())
            refuses(lambda: load_light_field(scene, positions=special), special)

        yield Case(f"positions in {special}", device)
    for place in ("1e999_0", "0_1e999", "5_5"):

        def rig(folder: Path, place=place) -> None:
            scene = write_stanford(folder / "scene", random_views())
            next(scene.glob("out_01_02_*")).rename(scene / f"out_01_02_{place}.png")
            refuses(lambda: load_light_field(scene), "scene")

        yield Case(f"a camera named {place}", rig)


def _maps() -> Iterator[Case]:
    headers = [
        b"", b"P", b"Pf", b"Pf\n", b"Pf\n8", b"Pf\n8 6", b"Pf\n8 6\n", b"Pf\n8 6\nx\n",
        b"PF\n8 6\n-1\n",
        b"Pf\n0 0\n-1\n", b"Pf\n-8 6\n-1\n", b"Pf\n8 6\n0\n", b"Pf\n8 6\nnan\n", b"Pf\n8 6\ninf\n",
        b"Pf\n8.0 6\n-1\n", b"Pf\n999999999 999999999\n-1\n", b"Pf\n" + b"9" * 5000 + b" 6\n-1\n",
        b"Pf\n" + b" " * 100_000, b"Pf\n8 6\n-1", b"P5\n8 6\n255\n", b"Pf 8 6 1e400\n",
        b"\0" * 64, "Pf\n８ ６\n-1\n".encode(), b"Pf\n1 1\n-1\n", b"Pf\n6 8\n-1\n",
        b"Pf\n8 5\n-1\n", b"Pf\r\n8 6\r\n-1\r\n", b"Pf \n8 6 \n-1 \n", b"Pf\n# a\n8 6\n-1\n",
        b"Pf\n#" + b"a" * 100_000, b"Pf\n" + b"#\n" * 50_000, b"Pf#8 6 -1\n",
    ]  # fmt: skip
    for index, header in enumerate(headers):

        def run(folder: Path, header=header) -> None:
            path = folder / "map.pfm"
            path.write_bytes(header + bytes(100))
            survives(lambda: read_pfm(path), "map.pfm")
            scene = hci(folder)
            (scene / "gt_disp_lowres.pfm").write_bytes(header + bytes(100))
            refuses(lambda: load_light_field(scene), "scene")

        yield Case(f"header {index} of a map: {header[:24]!r}", run)
    for value in (np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45):

        def odd(folder: Path, value=value) -> None:
            scene = hci(folder)
            values = TRUTH.copy()
            values[2, 3] = value
            write_pfm(scene / "gt_disp_lowres.pfm", values)
            survives(lambda: load_light_field(scene), "gt_disp_lowres.pfm")
            survives(lambda: load_ground_truth(scene), "gt_disp_lowres.pfm")

        yield Case(f"a disparity of {value}", odd)


def _colmap_maps() -> Iterator[Case]:
    """Depth maps of COLMAP: headers of any kind, and bytes flipped, cut out or cut off."""
    headers = [
        b"", b"8", b"8&6", b"8&6&1", b"0&0&1&", b"-8&6&1&", b"8&6&3&", b"8.0&6&1&", b" 8&6&1&",
        b"999999999&999999999&999999999&", b"9" * 5000 + b"&6&1&", b"&&&", b"\0" * 64,
        "８&６&1&".encode(), b"8&5&1&", b"5&5&1&",
    ]  # fmt: skip
    contents = [header + bytes(100) for header in headers]
    whole = b"4&3&1&" + np.linspace(1, 2, 12).astype("<f4").tobytes()
    contents += [mutated(whole, seed) for seed in range(30)]
    for index, content in enumerate(contents):

        def run(folder: Path, content=content) -> None:
            path = folder / "map.bin"
            path.write_bytes(content)
            survives(lambda: read_colmap_depth(path), "map.bin")

        yield Case(f"depth map {index} of COLMAP: {content[:24]!r}", run)


def _names() -> Iterator[Case]:
    for raw in NAMES:
        name = os.fsdecode(raw)

        def good(folder: Path, name=name) -> None:
            scene = write_hci(folder / "plain", random_views(), disparity=TRUTH)
            scene = scene.rename(folder / name)
            loaded = load_light_field(scene)
            assert loaded.name
            loaded.name.encode("utf-8")

        yield Case(f"a folder called {raw[:40]!r}", good)

        def damaged(folder: Path, name=name) -> None:
            scene = write_hci(folder / "plain", random_views())
            (scene / "input_Cam004.png").write_bytes(b"no picture")
            scene = scene.rename(folder / name)
            # What a name holds stays in it; the command escapes it, see `commands`.
            with pytest.raises(ValueError, match="input_Cam004.png"):
                load_light_field(scene)

        yield Case(f"a damaged folder called {raw[:40]!r}", damaged)
