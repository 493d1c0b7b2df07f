"""Configurations, positions and headers of maps: whatever can be written, is."""

import itertools
from pathlib import Path

import numpy as np
from datasets.layouts import CONFIGURATION, random_views, write_hci, write_stanford
from hostile.case import hostile, refuses, survives
from hostile.folders import occupy
from hostile.scenes import TRUTH, hci

from mvedge_jax.datasets import load_ground_truth, load_light_field, read_pfm, write_pfm

_PLAIN = CONFIGURATION.format(width=8, height=6, columns=3, rows=3)
_KEYS = {
    "num_cams_x": "3", "num_cams_y": "3", "image_resolution_x_px": "8",
    "image_resolution_y_px": "6", "focal_length_mm": "100.0", "sensor_size_mm": "35.0",
    "baseline_mm": "25.0", "focus_distance_m": "4.25", "disp_min": "-1.5", "disp_max": "1.25",
}  # fmt: skip
_BAD = ("nan", "inf", "-inf", "1e999", "x", "", "1,5", "0x10", "-0", "-3", "1e9")


def _configured(text: str | bytes, folder: Path) -> Path:
    scene = write_hci(folder / "scene", random_views())
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogateescape")
    (scene / "parameters.cfg").write_bytes(data)
    return scene


@hostile("{} = {!r}", itertools.product(_KEYS, _BAD))
def _value(folder: Path, key: str, bad: str) -> None:
    line = f"{key} = {_KEYS[key]}"
    assert line in _PLAIN
    scene = _configured(_PLAIN.replace(line, f"{key} = {bad}"), folder)
    survives(lambda: load_light_field(scene), "parameters.cfg")


@hostile("{:.12} cameras a side", ["1000000000", "30000", "101", "9" * 400])
def _many(folder: Path, cameras: str) -> None:
    text = _PLAIN.replace("num_cams_x = 3", f"num_cams_x = {cameras}")
    scene = _configured(text.replace("num_cams_y = 3", f"num_cams_y = {cameras}"), folder)
    refuses(lambda: load_light_field(scene), "parameters.cfg")


_TEXTS: dict[str, str | bytes] = {
    "with a byte order mark": b"\xef\xbb\xbf" + _PLAIN.encode(),
    "UTF-16": _PLAIN.encode("utf-16"),
    "Latin 1": "[meta]\nscene = caf\xe9\n".encode("latin-1"),
    "no sections": "a = 1\n" * 5000,
    "zeros": bytes(4000),
    "noise": bytes(range(256)) * 16,
    "one long line": "x" * 900_000,
    "two megabytes": "# comment\n" * 200_000,
    "duplicates": _PLAIN + _PLAIN,
    "interpolation": _PLAIN + "evil = %(evil)s ${evil}\n",
    "empty": "",
}


@hostile("parameters.cfg: {}", _TEXTS)
def _text(folder: Path, text: str | bytes) -> None:
    scene = _configured(text, folder)
    survives(lambda: load_light_field(scene), "parameters.cfg")
    assert text is not _TEXTS["with a byte order mark"] or load_light_field(scene).camera


_KINDS = ("/dev/zero", "/dev/urandom", "/dev/stdin", "fifo", "folder", "nothing", "loop")


@hostile("parameters.cfg is {}", _KINDS)
def _linked(folder: Path, kind: str) -> None:
    scene = write_hci(folder / "scene", random_views())
    occupy(scene / "parameters.cfg", kind)
    refuses(lambda: load_light_field(scene), "parameters.cfg")


_PLACES = ("nan", "inf", "1e999", "x", "", "1,5", "0", "9" * 400)


@hostile("{} with {!r:.9}", itertools.product(("positions_x", "positions_y"), _PLACES))
def _positions(folder: Path, key: str, bad: str) -> None:
    given = {"positions_x": "-1 0 1 " * 3, "positions_y": "-1 -1 -1 0 0 0 1 1 1"}
    given[key] = given[key].replace("1", bad, 1)
    lines = "".join(f"{name} = {value}\n" for name, value in given.items())
    scene = _configured(_PLAIN.replace("[meta]", f"{lines}\n[meta]"), folder)
    refuses(lambda: load_light_field(scene), "scene")


_WHOLE = "".join(f"{v} {u} {u - 1} {v - 1}\n" for v in range(3) for u in range(3))
_FILES = [
    b"", b"\xff\xfe", b"0 0", b"0 0 nan 0", b"0 0 1e999 0", b"-1 0 0 0", b"1e300 0 0 0",
    b"0 0 0 0\n0 0 0 0", b"0 0 0 0\n0 1 0 0\n0 2 0 0", b"0 0 0 0 " * 200_000,
    _WHOLE.replace("-1", "5").encode(), _WHOLE.replace("0 0 -1", "0 0 -1e9").encode(),
]  # fmt: skip


@hostile("positions {!r:.26}", _FILES)
def _filed(folder: Path, bad: bytes) -> None:
    scene = write_hci(folder / "scene", random_views())
    (folder / "positions.txt").write_bytes(bad)
    refuses(lambda: load_light_field(scene, positions=folder / "positions.txt"))


@hostile("a camera named {}", ["1e999_0", "0_1e999", "5_5"])
def _rig(folder: Path, place: str) -> None:
    scene = write_stanford(folder / "scene", random_views())
    next(scene.glob("out_01_02_*")).rename(scene / f"out_01_02_{place}.png")
    refuses(lambda: load_light_field(scene), "scene")


_HEADERS = [
    b"", b"P", b"Pf", b"Pf\n", b"Pf\n8", b"Pf\n8 6", b"Pf\n8 6\n", b"Pf\n8 6\nx\n",
    b"PF\n8 6\n-1\n",
    b"Pf\n0 0\n-1\n", b"Pf\n-8 6\n-1\n", b"Pf\n8 6\n0\n", b"Pf\n8 6\nnan\n", b"Pf\n8 6\ninf\n",
    b"Pf\n8.0 6\n-1\n", b"Pf\n999999999 999999999\n-1\n", b"Pf\n" + b"9" * 5000 + b" 6\n-1\n",
    b"Pf\n" + b" " * 100_000, b"Pf\n8 6\n-1", b"P5\n8 6\n255\n", b"Pf 8 6 1e400\n",
    b"\0" * 64, "Pf\n８ ６\n-1\n".encode(), b"Pf\n1 1\n-1\n", b"Pf\n6 8\n-1\n",
    b"Pf\n8 5\n-1\n", b"Pf\r\n8 6\r\n-1\r\n", b"Pf \n8 6 \n-1 \n", b"Pf\n# a\n8 6\n-1\n",
    b"Pf\n#" + b"a" * 100_000, b"Pf\n" + b"#\n" * 50_000, b"Pf#8 6 -1\n",
]  # fmt: skip


@hostile("header {} of a map: {!r:.26}", enumerate(_HEADERS))
def _header(folder: Path, _: int, header: bytes) -> None:
    path = folder / "map.pfm"
    path.write_bytes(header + bytes(100))
    survives(lambda: read_pfm(path), "map.pfm")
    scene = hci(folder)
    (scene / "gt_disp_lowres.pfm").write_bytes(header + bytes(100))
    refuses(lambda: load_light_field(scene), "scene")


@hostile("a disparity of {}", [np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-45])
def _disparity(folder: Path, value: float) -> None:
    scene = hci(folder)
    values = TRUTH.copy()
    values[2, 3] = value
    write_pfm(scene / "gt_disp_lowres.pfm", values)
    survives(lambda: load_light_field(scene), "gt_disp_lowres.pfm")
    survives(lambda: load_ground_truth(scene), "gt_disp_lowres.pfm")
