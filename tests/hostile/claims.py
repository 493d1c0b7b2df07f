"""Sizes that files only claim."""

import itertools
import struct
import zlib
from pathlib import Path

from datasets.layouts import random_views, write_grid, write_hci, write_stanford
from hostile.case import hostile, refuses
from hostile.scenes import hci, smooth

from mvedge_jax.datasets import load_light_field


def _png(width: int, height: int, *, lines: int = 0, depth: int = 8, color: int = 2) -> bytes:
    """A PNG that claims a size, and holds so many black lines of it."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + checksum

    row = 1 + width * {0: 1, 2: 3, 6: 4}[color] * depth // 8
    packer = zlib.compressobj(1)
    body = b"".join(packer.compress(bytes(row)) for _ in range(lines)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    return b"".join(
        [b"\x89PNG\r\n\x1a\n", chunk(b"IHDR", head), chunk(b"IDAT", body), chunk(b"IEND", b"")]
    )


def _jpeg(width: int, height: int) -> bytes:
    frame = struct.pack(">BHHB", 8, height, width, 3) + bytes([1, 17, 0, 2, 17, 0, 3, 17, 0])
    return b"\xff\xd8\xff\xc0" + struct.pack(">H", 2 + len(frame)) + frame + b"\xff\xd9"


def _bmp(width: int, height: int) -> bytes:
    head = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54, 0, 0, 54) + head


_MAKERS = {"png": _png, "bmp": _bmp, "jpg": _jpeg}
_SIDES = [(60_000, 60_000), (2**31 - 1, 2**31 - 1), (1, 2**31 - 1), (20_000, 30_000), (0, 0)]
_JPEGS = itertools.product(["jpg"], [(65_000, 65_000), (65_535, 1), (0, 0)], ["all views"])


@hostile(
    "{} of {} px claimed, {}",
    [*itertools.product(["png", "bmp"], _SIDES, ["all views", "one view"]), *_JPEGS],
)
def _claimed(folder: Path, suffix: str, side: tuple[int, int], which: str) -> None:
    scene = write_grid(folder / "scene", smooth(), pattern=f"v_{{}}_{{}}.{suffix}")
    for image in scene.iterdir() if which == "all views" else [scene / f"v_1_2.{suffix}"]:
        image.write_bytes(_MAKERS[suffix](*side))
    refuses(lambda: load_light_field(scene), f".{suffix}")


@hostile("png bomb, 30000x30000 zeros packed", fast=False)
def _packed(folder: Path) -> None:
    data = _png(30_000, 30_000, lines=30_000, color=0)
    assert len(data) < 20_000_000
    for k in range(9):
        (folder / f"v_{k // 3}_{k % 3}.png").write_bytes(data)
    refuses(lambda: load_light_field(folder), ".png", "GB", "max_gb")


@hostile("object ids of 50000x50000 px claimed")
def _ids(folder: Path) -> None:
    scene = hci(folder)
    (scene / "objectids_lowres.png").write_bytes(_png(50_000, 50_000, color=0))
    refuses(lambda: load_light_field(scene), "objectids_lowres.png")


@hostile("the limit is an option")
def _limit(folder: Path) -> None:
    scene = write_grid(folder / "scene", random_views())
    refuses(lambda: load_light_field(scene, max_gb=1e-6), "max_gb", ".png")
    assert load_light_field(scene, max_gb=1e-4).views.shape == (3, 3, 6, 8, 3)


_FAR = [(10**6, 1), (1, 10**6), (10**9, 10**9), (10**60, 0)]


@hostile("a view numbered {}", [100, 9999, 999_999, 100_000_000, 10**40])
def _far(folder: Path, number: int) -> None:
    scene = write_hci(folder / "scene", random_views(), settings=False)
    (scene / f"input_Cam{number}.png").write_bytes(_png(8, 6, lines=6))
    refuses(lambda: load_light_field(scene), "input_Cam")


_GRIDS = {
    "view": (write_grid, "lf_{}_{}.png"),
    "camera": (write_stanford, "out_{}_{}_1.0_2.0.png"),
}


@hostile("a {} at {}, {}", [(kind, *place) for kind in _GRIDS for place in _FAR])
def _far_away(folder: Path, kind: str, row: int, column: int) -> None:
    write, name = _GRIDS[kind]
    scene = write(folder / "scene", random_views())
    (scene / name.format(row, column)).write_bytes(_png(8, 6, lines=6))
    refuses(lambda: load_light_field(scene), "scene", "views")
