"""Files of every format with flipped, missing and doubled bytes."""

import itertools
import struct
import zlib
from pathlib import Path

import numpy as np
from datasets.layouts import random_views, write_grid, write_h5, write_mat
from hostile.case import hostile, mutated, survives
from hostile.scenes import hci, smooth

from mvedge_jax.datasets import load_light_field

_KINDS = ("png", "jpg", "bmp", "pfm", "cfg", "hdf5", "mat 7", "mat 7.3")


def _light_field(kind: str, folder: Path) -> tuple[Path, Path]:
    """A light field, and which of its files to damage."""
    if kind in ("png", "jpg", "bmp"):
        scene = write_grid(folder / "scene", smooth(), pattern=f"v_{{}}_{{}}.{kind}")
        return scene, scene / f"v_2_2.{kind}"
    if kind in ("pfm", "cfg"):
        scene = hci(folder)
        return scene, scene / {"pfm": "gt_disp_lowres.pfm", "cfg": "parameters.cfg"}[kind]
    if kind == "hdf5":
        depth = np.full((3, 3, 6, 8), 5.0, "f4")
        path = write_h5(folder / "scene.h5", random_views(), depth=depth)
    else:
        version = kind.partition(" ")[2]
        path = write_mat(folder / "scene.mat", random_views(), version=version)
    return path, path


@hostile("mutated {} {}", itertools.product(_KINDS, range(32)))
def _mutation(folder: Path, kind: str, seed: int) -> None:
    scene, victim = _light_field(kind, folder)
    victim.write_bytes(mutated(victim.read_bytes(), seed))
    survives(lambda: load_light_field(scene), "scene")


@hostile("mutated png with right checksums {}", range(32))
def _mended(folder: Path, seed: int) -> None:
    """Only the decoder could tell."""
    scene = hci(folder)
    victim = scene / "input_Cam004.png"
    data = victim.read_bytes()
    # Behind the signature and the header's length and kind.
    victim.write_bytes(_checked(data[:16] + mutated(data[16:], seed)))
    survives(lambda: load_light_field(scene), "scene")


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
