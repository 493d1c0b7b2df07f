"""Folders that hold pipes, devices, crowds or nothing; and options that no folder has."""

import itertools
import os
from pathlib import Path
from typing import Any

from datasets.layouts import random_views, write_grid
from hostile.case import hostile, refuses
from hostile.scenes import hci, smooth

from mvedge_jax.datasets import load_light_field


def occupy(path: Path, kind: str) -> None:
    """Puts something in the place of a file: a pipe, a folder, a link to itself or to a device."""
    path.unlink(missing_ok=True)
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(path if kind == "loop" else kind)


@hostile("{} as a scene", ["nowhere", "/dev/null", "/dev/zero", "/dev/random"])
def _no_scene(folder: Path, name: str) -> None:
    refuses(lambda: load_light_field(folder / name), name)


_KINDS = ("fifo", "/dev/zero", "folder", "loop")


@hostile("a {} that is {}", itertools.product(("png", "jpg", "bmp"), _KINDS))
def _special(folder: Path, suffix: str, kind: str) -> None:
    scene = write_grid(folder / "scene", smooth(), pattern=f"v_{{}}_{{}}.{suffix}")
    occupy(scene / f"v_2_2.{suffix}", kind)
    refuses(lambda: load_light_field(scene), f"v_2_2.{suffix}")


@hostile("a .{} that is {}", itertools.product(("h5", "mat"), _KINDS[:2]))
def _container(folder: Path, suffix: str, kind: str) -> None:
    path = folder / f"scene.{suffix}"
    occupy(path, kind)
    refuses(lambda: load_light_field(path), path.name)


@hostile("a folder whose child {!r} is a light field", ["scene", "b[y] {0}", "\u5834"])
def _parent(folder: Path, name: str) -> None:
    write_grid(folder / name, random_views())
    refuses(lambda: load_light_field(folder), name, "in it")


@hostile("3000 grids in one folder")
def _crowd(folder: Path) -> None:
    for k in range(3000):
        (folder / f"p{k:04d}_1_1.png").touch()
    refuses(lambda: load_light_field(folder), "several grids", "more")


_OPTIONS: tuple[dict[str, Any], ...] = (
    {"views": 0}, {"views": -3}, {"views": 4}, {"views": 10**9}, {"scale": 0.0}, {"scale": -1.0},
    {"scale": 2.0}, {"scale": float("nan")}, {"disparity_range": (1.0, 0.0)},
    {"disparity_range": (0.0, float("inf"))}, {"disparity_range": (float("nan"), 1.0)},
    {"disparity_range": (1.0, 1.0)}, {"max_gb": 0.0}, {"max_gb": -1.0}, {"max_gb": float("nan")},
)  # fmt: skip


@hostile("load_light_field with {}", _OPTIONS)
def _option(folder: Path, options: dict[str, Any]) -> None:
    scene = hci(folder)
    refuses(lambda: load_light_field(scene, **options), f"`{next(iter(options))}`")
