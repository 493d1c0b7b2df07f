"""Folders that hold pipes, devices, crowds or nothing."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from datasets.layouts import (
    write_grid,
)
from hostile.case import Case, refuses
from hostile.scenes import hci, smooth

from mvedge_jax.datasets import load_light_field


def cases() -> Iterator[Case]:
    """All of them."""
    yield from _folders()


def _folders() -> Iterator[Case]:
    def nothing(folder: Path) -> None:
        refuses(lambda: load_light_field(folder / "nowhere"), "nowhere")

    yield Case("a folder that is not there", nothing)
    for device in ("/dev/null", "/dev/zero", "/dev/random"):
        yield Case(
            f"{device} as a scene", lambda _, d=device: refuses(lambda: load_light_field(d), d)
        )
    for suffix in ("png", "jpg", "bmp"):
        for kind in ("fifo", "/dev/zero", "folder", "loop"):

            def special(folder: Path, suffix=suffix, kind=kind) -> None:
                scene = write_grid(folder / "scene", smooth(), pattern=f"v_{{}}_{{}}.{suffix}")
                victim = scene / f"v_2_2.{suffix}"
                victim.unlink()
                if kind == "fifo":
                    os.mkfifo(victim)
                elif kind == "folder":
                    victim.mkdir()
                else:
                    victim.symlink_to(victim if kind == "loop" else kind)
                refuses(lambda: load_light_field(scene), victim.name)

            yield Case(f"a {suffix} that is {kind}", special)
    for kind in ("h5", "mat"):
        for other in ("fifo", "/dev/zero"):

            def container(folder: Path, kind=kind, other=other) -> None:
                path = folder / f"scene.{kind}"
                if other == "fifo":
                    os.mkfifo(path)
                else:
                    path.symlink_to(other)
                refuses(lambda: load_light_field(path), path.name)

            yield Case(f"a .{kind} that is {other}", container)

    def crowd(folder: Path) -> None:
        for k in range(3000):
            (folder / f"p{k:04d}_1_1.png").touch()
        refuses(lambda: load_light_field(folder), "several grids", "more")

    yield Case("3000 grids in one folder", crowd)
    wrong_options: tuple[dict[str, Any], ...] = (
        {"views": 0}, {"views": -3}, {"views": 4}, {"views": 10**9}, {"scale": 0.0},
        {"scale": -1.0}, {"scale": 2.0}, {"scale": float("nan")}, {"disparity_range": (1.0, 0.0)},
        {"disparity_range": (0.0, float("inf"))}, {"disparity_range": (float("nan"), 1.0)},
        {"disparity_range": (1.0, 1.0)},
    )  # fmt: skip
    for options in wrong_options:

        def wrong(folder: Path, options=options) -> None:
            scene = hci(folder)
            refuses(lambda: load_light_field(scene, **options), f"`{next(iter(options))}`")

        yield Case(f"load_light_field with {options}", wrong)
