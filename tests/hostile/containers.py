"""HDF5 and MATLAB files that claim, link and hold what they should not."""

import itertools
import struct
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
from datasets.layouts import random_views, write_h5, write_mat
from hostile.case import hostile, refuses, survives

from mvedge_jax.datasets import load_light_field

_HUGE = (3, 3, 60_000, 60_000, 3)


def _claims(folder: Path, shape: tuple[int, ...], **options) -> Path:
    path = folder / "scene.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("LF", shape, "u1", **options)
    return path


_STORED: dict[str, dict[str, Any]] = {
    "contiguous": {},
    "packed": {"compression": "gzip", "chunks": (1, 1, 64, 64, 3)},
    "in one chunk": {
        "chunks": (1, 1, 20_000, 20_000, 3), "maxshape": (None,) * 5, "compression": "gzip"
    },
}  # fmt: skip


@hostile("hdf5 of 60000x60000 px claimed, {}", _STORED)
def _large(folder: Path, options: dict[str, Any]) -> None:
    path = _claims(folder, _HUGE, **options)
    refuses(lambda: load_light_field(path), "scene.h5", "max_gb")


@hostile("hdf5 with chunks larger than its views")
def _chunk(folder: Path) -> None:
    options = {"chunks": (3, 3, 40_000, 40_000, 3), "maxshape": (None,) * 5}
    try:
        path = _claims(folder, (3, 3, 6, 8, 3), **options)
    except (ValueError, OSError):  # this HDF5 refuses to make it
        return
    refuses(lambda: load_light_field(path), "scene.h5")


@hostile("mat 7.3 of 60000x60000 px claimed")
def _large_mat(folder: Path) -> None:
    path = write_mat(folder / "scene.mat", random_views(), version="7.3")
    with h5py.File(path, "r+") as file:
        del file["LF"]
        file.create_dataset("LF", _HUGE[::-1], "u1")
    refuses(lambda: load_light_field(path), "scene.mat", "max_gb")


@hostile("hdf5 of 100000x100000 views claimed")
def _many(folder: Path) -> None:
    path = _claims(folder, (100_000, 100_000, 1, 1, 3), chunks=(10, 10, 1, 1, 3))
    refuses(lambda: load_light_field(path), "scene.h5", "views")


_ATTRIBUTES = {
    "text": "x", "nothing": h5py.Empty("f"), "nan": float("nan"), "inf": float("inf"),
    "an array": np.zeros(0), "zero": 0.0, "1e300": 1e300, "-1": -1.0,
}  # fmt: skip


@hostile("the attribute {} is {}", itertools.product(("dH", "focalLength", "shift"), _ATTRIBUTES))
def _attribute(folder: Path, key: str, name: str) -> None:
    depth = np.full((3, 3, 6, 8), 5.0, "f4")
    path = write_h5(folder / "scene.h5", random_views(), depth=depth)
    with h5py.File(path, "r+") as file:
        file.attrs[key] = _ATTRIBUTES[name]
    survives(lambda: load_light_field(path), "scene.h5")


_ARRAYS: dict[str, Any] = {
    "text": np.full((3, 3, 6, 8, 3), b"x"),
    "complex": np.zeros((3, 3, 6, 8, 3), "c8"),
    "no rows": random_views()[:0],
    "no pixels": random_views()[:, :, :0],
    "bool": random_views() > 100,
    "a number": np.asarray(3, np.uint8),
    "one view": random_views()[:1, :1],
}


@hostile("{} of {}", itertools.product(("hdf5", "mat 7", "mat 7.3"), _ARRAYS))
def _array(folder: Path, kind: str, name: str) -> None:
    if kind == "hdf5":
        path = write_h5(folder / "scene.h5", _ARRAYS[name])
    else:
        path = write_mat(folder / "scene.mat", _ARRAYS[name], version=kind.partition(" ")[2])
    refuses(lambda: load_light_field(path), "scene")


_LINKS = {
    "a link into another file": h5py.ExternalLink("other.h5", "/LF"),
    "a soft link": h5py.SoftLink("/elsewhere"),
    "a link to itself": h5py.SoftLink("/LF"),
}


@hostile("hdf5: {}", _LINKS)
def _link(folder: Path, link: Any) -> None:
    write_h5(folder / "other.h5", random_views())
    with h5py.File(folder / "scene.h5", "w") as file:
        file["LF"] = link
    refuses(lambda: load_light_field(folder / "scene.h5"), "scene.h5")


@hostile("hdf5: numbers in another file")
def _outside(folder: Path) -> None:
    (folder / "raw").write_bytes(bytes(3 * 3 * 6 * 8 * 3))
    external = [(str(folder / "raw"), 0, h5py.h5f.UNLIMITED)]
    path = _claims(folder, (3, 3, 6, 8, 3), external=external)
    refuses(lambda: load_light_field(path), "other files")


@hostile("hdf5: a virtual data set")
def _virtual(folder: Path) -> None:
    write_h5(folder / "other.h5", random_views())
    layout = h5py.VirtualLayout((3, 3, 6, 8, 3), "u1")
    layout[:] = h5py.VirtualSource(folder / "other.h5", "LF", (3, 3, 6, 8, 3))
    with h5py.File(folder / "scene.h5", "w") as file:
        file.create_virtual_dataset("LF", layout)
    refuses(lambda: load_light_field(folder / "scene.h5"), "other files")


@hostile("a .{} that is crowded", ["h5", "mat"])
def _crowd(folder: Path, suffix: str) -> None:
    path = folder / f"scene.{suffix}"
    if suffix == "mat":
        scipy.io.savemat(path, {f"v{k}": k for k in range(3000)})
    else:
        with h5py.File(path, "w") as file:
            for k in range(3000):
                file.create_group(f"group {k}")
    refuses(lambda: load_light_field(path), path.name, "more")


_NO_ARRAYS = {
    "a cell": np.array([["a", 1.0]], object), "a struct": {"LF": 1}, "text": "LF", "a map": {},
}  # fmt: skip


@hostile("mat: LF is {}", _NO_ARRAYS)
def _no_array(folder: Path, value: Any) -> None:
    scipy.io.savemat(folder / "scene.mat", {"LF": value})
    refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat")


def _variable(dims: tuple[int, ...], claimed: int, data: bytes) -> bytes:
    """A compressed variable LF of version 5 whose numbers claim so many bytes."""
    flags = struct.pack("<IIII", 6, 8, 9, 0)
    sides = struct.pack(f"<II{len(dims)}i", 5, 4 * len(dims), *dims)
    sides += b"\0" * (-len(sides) % 8)
    name = struct.pack("<II", 1, 2) + b"LF" + b"\0" * 6
    body = flags + sides + name + struct.pack("<II", 2, claimed) + data
    inner = struct.pack("<II", 14, len(body)) + body
    packed = zlib.compress(inner, 1)
    return struct.pack("<II", 15, len(packed)) + packed


_HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
_BOMBS = {
    "dimensions": ((3, 3, 60_000, 60_000, 3), 432, 432),
    "length": ((3, 3, 4, 4, 3), 2**32 - 8, 432),
    "negative dimensions": ((3, 3, -4, -4, 3), 432, 432),
    "contents": ((3, 3, 4, 4, 3), 10**8, 10**8),
}


@hostile("mat bomb: {}", _BOMBS)
def _bomb(folder: Path, dims: tuple[int, ...], claimed: int, held: int) -> None:
    (folder / "scene.mat").write_bytes(_HEAD + _variable(dims, claimed, bytes(held)))
    refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat")


_ODD = {
    "an element longer than the file": _HEAD + struct.pack("<II", 14, 2**31),
    "an empty file": b"",
    "half a header": _HEAD[:100],
    "a header": _HEAD,
    "version 4": struct.pack("<5i", 0, 60_000, 60_000, 0, 3) + b"LF\0",
    "zeros": bytes(1000),
    "no data in zlib": _HEAD + struct.pack("<II", 15, 4) + b"\x78\x9c\0\0",
}


@hostile("mat: {}", _ODD)
def _odd(folder: Path, data: bytes) -> None:
    (folder / "scene.mat").write_bytes(data)
    refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat")
