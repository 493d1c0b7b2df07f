"""Files of every format with flipped, missing and doubled bytes."""

import struct
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from datasets.layouts import (
    random_views,
    write_grid,
    write_h5,
    write_mat,
)
from hostile.case import Case, mutated, survives
from hostile.scenes import hci, smooth

from mvedge_jax.datasets import load_light_field

_MUTATIONS = 32


def cases() -> Iterator[Case]:
    """All of them."""
    yield from _mutations()
    yield from _mended()


def _formats() -> dict[str, Callable[[Path], tuple[Path, Path]]]:
    """How to make a light field, and which of its files to damage."""

    def grid(suffix: str, folder: Path) -> tuple[Path, Path]:
        scene = write_grid(folder / "scene", smooth(), pattern=f"v_{{}}_{{}}.{suffix}")
        return scene, scene / f"v_2_2.{suffix}"

    def within(name: str, folder: Path) -> tuple[Path, Path]:
        scene = hci(folder)
        return scene, scene / name

    def h5(folder: Path) -> tuple[Path, Path]:
        depth = np.full((3, 3, 6, 8), 5.0, "f4")
        path = write_h5(folder / "scene.h5", random_views(), depth=depth)
        return path, path

    def mat(version: str, folder: Path) -> tuple[Path, Path]:
        path = write_mat(folder / "scene.mat", random_views(), version=version)
        return path, path

    return {
        "png": partial(grid, "png"),
        "jpg": partial(grid, "jpg"),
        "bmp": partial(grid, "bmp"),
        "pfm": partial(within, "gt_disp_lowres.pfm"),
        "cfg": partial(within, "parameters.cfg"),
        "hdf5": h5,
        "mat 7": partial(mat, "7"),
        "mat 7.3": partial(mat, "7.3"),
    }


def _mutations() -> Iterator[Case]:
    for kind, make in _formats().items():
        for seed in range(_MUTATIONS):

            def run(folder: Path, make=make, seed=seed) -> None:
                scene, victim = make(folder)
                victim.write_bytes(mutated(victim.read_bytes(), seed))
                survives(lambda: load_light_field(scene), "scene")

            yield Case(f"mutated {kind} {seed}", run)


def _mended() -> Iterator[Case]:
    """PNGs that are damaged, with checksums that are not: only the decoder could tell."""
    for seed in range(_MUTATIONS):

        def run(folder: Path, seed=seed) -> None:
            scene = hci(folder)
            victim = scene / "input_Cam004.png"
            data = victim.read_bytes()
            # Behind the signature and the header's length and kind.
            victim.write_bytes(_checked(data[:16] + mutated(data[16:], seed)))
            survives(lambda: load_light_field(scene), "scene")

        yield Case(f"mutated png with right checksums {seed}", run)


def _checked(data: bytes) -> bytes:
    """A PNG with the right checksum in every chunk."""
    out, position = bytearray(data), 8
    while position + 12 <= len(out):
        end = position + 8 + int.from_bytes(out[position : position + 4], "big")
        if end + 4 > len(out):
            break
        out[end : end + 4] = struct.pack(">I", zlib.crc32(out[position + 4 : end]))
        position = end + 4
    return bytes(out)
