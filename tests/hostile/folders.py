"""Folders that hold pipes, devices, crowds or nothing."""

import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from datasets.layouts import (
    random_views,
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

    for name in ("scene", "b[y] {0}", "\u5834"):

        def parent(folder: Path, name=name) -> None:
            write_grid(folder / name, random_views())
            refuses(lambda: load_light_field(folder), name, "in it")

        yield Case(f"a folder whose child {name!r} is a light field", parent)

    for what, value in {"black": 0, "white": 255, "of one color": 90}.items():

        def dead(folder: Path, what=what, value=value) -> None:
            views = random_views((3, 3, 16, 16, 3))
            views[1, 1] = value
            scene = write_grid(folder / "scene", views, pattern="v_{}_{}.png")
            refuses(lambda: load_light_field(scene), "v_2_2.png", what)

        yield Case(f"a centre view that is {what}", dead)

        def left_out(folder: Path, what=what, value=value) -> None:
            views = random_views((3, 3, 16, 16, 3))
            views[1, 2] = value
            scene = write_grid(folder / "scene", views, pattern="v_{}_{}.png")
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                assert not load_light_field(scene).available[1, 2]
            assert f"v_2_3.png is {what}." in str(said[0].message)

        yield Case(f"a view of the crosshair that is {what}", left_out)

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
