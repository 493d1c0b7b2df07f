"""HDF5 and MATLAB files that claim, link and hold what they should not."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import scipy.io
from datasets.layouts import (
    random_views,
    write_h5,
    write_mat,
)
from hostile.case import Case, refuses, survives

from mvedge_jax.datasets import load_light_field


def cases() -> Iterator[Case]:
    """All of them."""
    yield from _containers()
    yield from _attributes()
    yield from _arrays()
    yield from _links()
    yield from _crowds()
    yield from _mat_bombs()


def _containers() -> Iterator[Case]:
    huge = (3, 3, 60_000, 60_000, 3)

    def claims(folder: Path, shape: tuple[int, ...], **options) -> Path:
        path = folder / "scene.h5"
        with h5py.File(path, "w") as file:
            file.create_dataset("LF", shape, "u1", **options)
        return path

    for label, options in {
        "contiguous": {},
        "packed": {"compression": "gzip", "chunks": (1, 1, 64, 64, 3)},
        "in one chunk": {
            "chunks": (1, 1, 20_000, 20_000, 3), "maxshape": (None,) * 5, "compression": "gzip"
        },
    }.items():  # fmt: skip

        def big(folder: Path, options=options) -> None:
            path = claims(folder, huge, **options)
            refuses(lambda: load_light_field(path), "scene.h5", "max_gb")

        yield Case(f"hdf5 of 60000x60000 px claimed, {label}", big)

    def chunk(folder: Path) -> None:
        options = {"chunks": (3, 3, 40_000, 40_000, 3), "maxshape": (None,) * 5}
        try:
            path = claims(folder, (3, 3, 6, 8, 3), **options)
        except (ValueError, OSError):  # this HDF5 refuses to make it
            return
        refuses(lambda: load_light_field(path), "scene.h5")

    yield Case("hdf5 with chunks larger than its views", chunk)

    def reversed_huge(folder: Path) -> None:
        path = write_mat(folder / "scene.mat", random_views(), version="7.3")
        with h5py.File(path, "r+") as file:
            del file["LF"]
            file.create_dataset("LF", huge[::-1], "u1")
        refuses(lambda: load_light_field(path), "scene.mat", "max_gb")

    yield Case("mat 7.3 of 60000x60000 px claimed", reversed_huge)

    for version in ("7", "7.3"):
        for shape in ((15, 16, 9, 9, 3), (300, 200, 3, 3, 2), (9, 9, 5, 5, 3), (200, 200, 1, 1, 3)):

            def order(folder: Path, version=version, shape=shape) -> None:
                path = write_mat(folder / "scene.mat", random_views(shape), version=version)
                refuses(lambda: load_light_field(path, views=7), "scene")

            yield Case(f"mat {version} of shape {shape}", order)

    def many(folder: Path) -> None:
        path = claims(folder, (100_000, 100_000, 1, 1, 3), chunks=(10, 10, 1, 1, 3))
        refuses(lambda: load_light_field(path), "scene.h5", "views")

    yield Case("hdf5 of 100000x100000 views claimed", many)


def _attributes() -> Iterator[Case]:
    for name, value in {
        "text": "x",
        "nothing": h5py.Empty("f"),
        "nan": float("nan"),
        "inf": float("inf"),
        "an array": np.zeros(0),
        "zero": 0.0,
        "1e300": 1e300,
        "-1": -1.0,
    }.items():
        for key in ("dH", "focalLength", "shift"):

            def attribute(folder: Path, key=key, value=value) -> None:
                depth = np.full((3, 3, 6, 8), 5.0, "f4")
                path = write_h5(folder / "scene.h5", random_views(), depth=depth)
                with h5py.File(path, "r+") as file:
                    file.attrs[key] = value
                survives(lambda: load_light_field(path), "scene.h5")

            yield Case(f"the attribute {key} is {name}", attribute)
    depths = {
        "nan": np.nan, "inf": np.inf, "zero": 0.0, "negative": -1.0, "1e300": 1e300,
        "1e-300": 1e-300,
    }  # fmt: skip
    for name, value in depths.items():

        def depth_of(folder: Path, value=value) -> None:
            depth = np.full((3, 3, 6, 8), 5.0)
            depth[1, 1, 2, 2] = value
            path = write_h5(folder / "scene.h5", random_views(), depth=depth)
            survives(lambda: load_light_field(path), "scene.h5")

        yield Case(f"a depth of {name}", depth_of)


def _arrays() -> Iterator[Case]:
    arrays = {
        "text": np.full((3, 3, 6, 8, 3), b"x"),
        "complex": np.zeros((3, 3, 6, 8, 3), "c8"),
        "4-D": random_views()[0],
        "no rows": random_views()[:0],
        "no pixels": random_views()[:, :, :0],
        "two channels": random_views()[..., :2],
        "float": random_views().astype("f4"),
        "bool": random_views() > 100,
        "a number": np.uint8(3),
        "one view": random_views()[:1, :1],
    }
    for name, array in arrays.items():

        def h5_of(folder: Path, array=array) -> None:
            path = write_h5(folder / "scene.h5", array)
            refuses(lambda: load_light_field(path), "scene")

        yield Case(f"hdf5 of {name}", h5_of)
        for version in ("7", "7.3"):

            def mat_of(folder: Path, array=array, version=version) -> None:
                path = write_mat(folder / "scene.mat", np.asarray(array), version=version)
                refuses(lambda: load_light_field(path), "scene")

            yield Case(f"mat {version} of {name}", mat_of)


def _links() -> Iterator[Case]:
    links = {
        "a link into another file": h5py.ExternalLink("other.h5", "/LF"),
        "a soft link": h5py.SoftLink("/elsewhere"),
        "a link to itself": h5py.SoftLink("/LF"),
    }
    for name, link in links.items():

        def h5_link(folder: Path, link=link) -> None:
            write_h5(folder / "other.h5", random_views())
            with h5py.File(folder / "scene.h5", "w") as file:
                file["LF"] = link
            refuses(lambda: load_light_field(folder / "scene.h5"), "scene.h5")

        yield Case(f"hdf5: {name}", h5_link)

    def outside(folder: Path) -> None:
        (folder / "raw").write_bytes(bytes(3 * 3 * 6 * 8 * 3))
        with h5py.File(folder / "scene.h5", "w") as file:
            external = [(str(folder / "raw"), 0, h5py.h5f.UNLIMITED)]
            file.create_dataset("LF", (3, 3, 6, 8, 3), "u1", external=external)
        refuses(lambda: load_light_field(folder / "scene.h5"), "other files")

    yield Case("hdf5: numbers in another file", outside)

    def virtual(folder: Path) -> None:
        write_h5(folder / "other.h5", random_views())
        layout = h5py.VirtualLayout((3, 3, 6, 8, 3), "u1")
        layout[:] = h5py.VirtualSource(folder / "other.h5", "LF", (3, 3, 6, 8, 3))
        with h5py.File(folder / "scene.h5", "w") as file:
            file.create_virtual_dataset("LF", layout)
        refuses(lambda: load_light_field(folder / "scene.h5"), "other files")

    yield Case("hdf5: a virtual data set", virtual)


def _crowds() -> Iterator[Case]:
    def crowd(folder: Path) -> None:
        with h5py.File(folder / "scene.h5", "w") as file:
            for k in range(5000):
                file.create_group(f"group {k}")
        refuses(lambda: load_light_field(folder / "scene.h5"), "scene.h5", "more")

    yield Case("hdf5 with 5000 groups", crowd)

    def crowded_mat(folder: Path) -> None:
        scipy.io.savemat(folder / "scene.mat", {f"v{k}": k for k in range(3000)})
        refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat", "more")

    yield Case("mat with 3000 variables", crowded_mat)
    others = {
        "a cell": np.array([["a", 1.0]], object),
        "a struct": {"LF": 1},
        "text": "LF",
        "a map": {},
    }
    for name, value in others.items():

        def mat_other(folder: Path, value=value) -> None:
            scipy.io.savemat(folder / "scene.mat", {"LF": value})
            refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat")

        yield Case(f"mat: LF is {name}", mat_other)


def _mat_bombs() -> Iterator[Case]:
    def variable(dims: tuple[int, ...], claimed: int, data: bytes) -> bytes:
        """A compressed variable LF of version 5 whose numbers claim so many bytes."""
        flags = struct.pack("<IIII", 6, 8, 9, 0)
        sides = struct.pack(f"<II{len(dims)}i", 5, 4 * len(dims), *dims)
        sides += b"\0" * (-len(sides) % 8)
        name = struct.pack("<II", 1, 2) + b"LF" + b"\0" * 6
        body = flags + sides + name + struct.pack("<II", 2, claimed) + data
        inner = struct.pack("<II", 14, len(body)) + body
        packed = zlib.compress(inner, 1)
        return struct.pack("<II", 15, len(packed)) + packed

    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    bombs = {
        "dimensions": ((3, 3, 60_000, 60_000, 3), 432, bytes(432)),
        "length": ((3, 3, 4, 4, 3), 2**32 - 8, bytes(432)),
        "negative dimensions": ((3, 3, -4, -4, 3), 432, bytes(432)),
        "contents": ((3, 3, 4, 4, 3), 10**8, bytes(10**8)),
    }
    for name, (dims, claimed, data) in bombs.items():

        def run(folder: Path, dims=dims, claimed=claimed, data=data) -> None:
            (folder / "scene.mat").write_bytes(head + variable(dims, claimed, data))
            refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat")

        yield Case(f"mat bomb: {name}", run)
    for name, data in {
        "an element longer than the file": head + struct.pack("<II", 14, 2**31),
        "an empty file": b"",
        "half a header": head[:100],
        "a header": head,
        "version 4": struct.pack("<5i", 0, 60_000, 60_000, 0, 3) + b"LF\0",
        "zeros": bytes(1000),
        "no data in zlib": head + struct.pack("<II", 15, 4) + b"\x78\x9c\0\0",
    }.items():

        def odd(folder: Path, data=data) -> None:
            (folder / "scene.mat").write_bytes(data)
            refuses(lambda: load_light_field(folder / "scene.mat"), "scene.mat")

        yield Case(f"mat: {name}", odd)
