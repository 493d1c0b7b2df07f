"""Irregular views (8.1.4): uneven rows and arrays of oblong cells, beside regular ones.

Rendered scenes are written in the Stanford archive's naming, whose names tell the positions of the
cameras, and are read by `load_light_field`. A row: regular; with every second view moved by up to
0.4 steps; the same taken as regular, which shows what knowing the positions is worth; with every
second view missing, once as positions two steps apart and once as missing views, beside the regular
row of as many views. An array of 5x5 views whose rows are 1.5 times as far apart as its columns,
beside the square one, and taken as one. Errors are in px per step of the regular row.

    python experiments/irregular_views.py --out results/irregular_views
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from _report import print_table, write_csv, write_json

from mvedge_jax import EdgeDepth
from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores

# Millimeters from one camera to the next, for the names.
_PITCH = 60.0


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scenes: rendered scenes.
        views: of the regular row; odd.
        side: views per side of the array; odd.
        size: side of the views, px.
        preset: of `EdgeDepth`.
        out: folder for the table.
    """

    scenes: tuple[str, ...] = ("demo", "slanted")
    views: int = 17
    side: int = 5
    size: int = 96
    preset: Literal["full", "edges"] = "full"
    out: Path = Path("results/irregular_views")


def stanford_folder(light_field: LightField, folder: Path) -> Path:
    """Writes views in the Stanford archive's naming, with the positions of their cameras."""
    folder.mkdir()
    for v, u in np.ndindex(light_field.available.shape):
        x, y = -_PITCH * np.asarray(light_field.steps[v, u], float)
        name = folder / f"out_{v:02d}_{u:02d}_{y:.6f}_{x:.6f}.png"
        pixels = np.round(255 * np.asarray(light_field.views[v, u])).astype(np.uint8)
        cv2.imwrite(str(name), pixels[..., ::-1])
    return folder


def rendered(name: str, positions: np.ndarray, size: int) -> tuple[LightField, LightField]:
    """A scene as it was rendered, and as it is read from files."""
    light_field = synthetic.render(
        synthetic.scene(name),
        shape=(*positions.shape[:2], size, size),
        positions=positions,
        samples=2,
        key=jax.random.key(0),
    )
    with tempfile.TemporaryDirectory() as folder:
        return light_field, load_light_field(stanford_folder(light_field, Path(folder) / name))


def grid(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Positions of rows and columns of views."""
    return np.stack(np.meshgrid(columns, rows), axis=-1)


def cases(name: str, arguments: Arguments) -> Iterator[tuple[str, LightField, float, LightField]]:
    """Label, views as read, their view step in steps of the regular row, and the truth."""
    half = arguments.views // 2
    even = np.arange(-half, half + 1.0)
    second = np.arange(len(even)) % 2 != half % 2
    away = np.random.default_rng(0).uniform(-0.4, 0.4, len(even))
    moved = even + np.where(second, away, 0)
    one = np.zeros(1)
    true, row = rendered(name, grid(one, even), arguments.size)
    yield f"row of {len(even)}", row, 1.0, true
    places = [(0, int(u)) for u in np.flatnonzero(second)]
    yield f"row of {len(even)}, every second view not available", row.without_views(places), 1, true
    shown, uneven = rendered(name, grid(one, moved), arguments.size)
    unit = float(np.median(np.diff(moved)))
    yield "every second view moved", uneven, unit, shown
    blind = eqx.tree_at(lambda s: s.positions, uneven, None)
    yield "every second view moved, taken as regular", blind, 1.0, shown
    few, sparse = rendered(name, grid(one, even[~second]), arguments.size)
    yield f"row of {(~second).sum()}, twice as far apart", sparse, 2.0, few
    apart = jnp.asarray(grid(one, even[~second]), jnp.float32)
    wide = LightField(sparse.views, positions=apart)
    yield f"row of {len(even)}, every second view missing", wide, 1.0, few
    array = np.arange(arguments.side) - arguments.side // 2
    for label, pitch in (("array", 1.0), ("array, rows 1.5 times as far apart", 1.5)):
        true, read = rendered(name, grid(pitch * array, 1.0 * array), arguments.size)
        yield label, read, 1.0, true
        if pitch != 1:
            blind = eqx.tree_at(lambda s: s.positions, read, None)
            yield f"{label}, taken as square", blind, 1.0, true


def main() -> None:
    """Measures all rows and arrays of all scenes."""
    arguments, rows = tyro.cli(Arguments, description=__doc__), []
    limits = np.array([synthetic.scene(name).disparity_range for name in arguments.scenes])
    low, high = float(limits[:, 0].min()), float(limits[:, 1].max())
    for name in arguments.scenes:
        for label, views, unit, rendering in cases(name, arguments):
            # One range for all scenes: they share their programs.
            ends = jnp.asarray([unit * low, unit * high], views.views.dtype)
            ranged = eqx.tree_at(
                lambda s: s.disparity_range, views, ends, is_leaf=lambda leaf: leaf is None
            )
            start = time.perf_counter()
            model = EdgeDepth.for_light_field(ranged, preset=arguments.preset)
            disparity = jax.block_until_ready(model(ranged).disparity) / unit
            truth = rendering.truth
            assert truth is not None
            scores = depth_scores(disparity, truth.disparity, mask=truth.valid)
            rows.append(
                {
                    "scene": name,
                    "views": label,
                    "MSE*100": float(scores.mse),
                    "Q25*100": float(scores.q25),
                    "BP(.03)": float(scores.bad_03),
                    "BP(.07)": float(scores.bad_07),
                    "seconds with compilation": round(time.perf_counter() - start, 1),
                }
            )
            print(rows[-1], flush=True)
    print_table(rows, title=f"{arguments.size} px, preset {arguments.preset}")
    write_csv(arguments.out / "irregular_views.csv", rows)
    write_json(arguments.out / "irregular_views.json", rows)


if __name__ == "__main__":
    main()
