"""Files of every format with flipped, missing and doubled bytes."""

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
