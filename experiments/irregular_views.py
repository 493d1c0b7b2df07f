"""Irregular views (8.1.4): a row of views at uneven, known positions, beside the regular row.

Views of a rendered scene are taken as photographs with their cameras, which may stand anywhere
(`mvedge_jax.posed`). The positions: a regular row; the same with every second view missing; with
every second one moved by up to 0.4 steps; and the moved one as if it were regular, which shows what
knowing the positions is worth. Disparities are in px per step of the regular row.

    python experiments/irregular_views.py --out results/irregular_views
"""

import time
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from _report import print_table, write_csv, write_json

from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import depth
from mvedge_jax.lightfield import Camera, LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.posed import Photographs, StereoDepth, reference_of, stereo
from mvedge_jax.posed.cloud import camera_of_view


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scenes: rendered scenes.
        views: of the regular row; odd.
        size: side of the views, px.
        out: folder for the table.
    """

    scenes: tuple[str, ...] = ("demo", "slanted")
    views: int = 17
    size: int = 96
    out: Path = Path("results/irregular_views")


def row_of_views(name: str, offsets: np.ndarray, camera: Camera, size: int) -> Photographs:
    """A scene from cameras `offsets` steps to the right of the centre."""
    cameras = [camera_of_view(camera, jnp.asarray([x, 0.0]), (size, size)) for x in offsets]
    poses, matrices = (jnp.stack(part) for part in zip(*cameras, strict=True))
    shown = synthetic.render_posed(
        synthetic.scene(name), poses, matrices, size=(size, size), samples=2, key=jax.random.key(0)
    )
    return Photographs(shown.images, shown.poses, shown.intrinsics)


def disparity_of(
    photographs: Photographs, offsets: np.ndarray, regular: LightField
) -> tuple[jax.Array, float]:
    """The centre photograph's disparity per regular step, and the seconds it took."""
    camera = regular.camera
    assert camera is not None
    assert regular.disparity_range is not None
    far, near = (float(camera.depth(d)) for d in regular.disparity_range)
    far = far if np.isfinite(far) else 1e3 * near
    wanted = reference_of(photographs, int(np.abs(offsets).argmin()), depth_range=(near, far))
    start = time.perf_counter()
    found = jax.block_until_ready(stereo(photographs, wanted, StereoDepth.of(wanted)))
    return camera.disparity(found.depth), time.perf_counter() - start


def main() -> None:
    """Measures all rows of views of all scenes."""
    arguments = tyro.cli(Arguments, description=__doc__)
    half, rows = arguments.views // 2, []
    even = np.arange(-half, half + 1.0)
    second = np.arange(len(even)) % 2 != half % 2
    away = np.random.default_rng(0).uniform(-0.4, 0.4, len(even))
    moved = even + np.where(second, away, 0)
    for name in arguments.scenes:
        size = arguments.size
        regular = synthetic.render(
            synthetic.scene(name),
            shape=(1, arguments.views, size, size),
            samples=2,
            key=jax.random.key(0),
        )
        truth, camera = regular.truth, regular.camera
        assert truth is not None
        assert camera is not None
        row, uneven = (row_of_views(name, x, camera, size) for x in (even, moved))
        ignored = eqx.tree_at(
            lambda p: (p.poses, p.intrinsics), uneven, (row.poses, row.intrinsics)
        )
        sparse = Photographs(row.images[~second], row.poses[~second], row.intrinsics[~second])
        before = time.perf_counter()
        blind = regular.without_truth()
        chain = depth(blind).disparity
        found = {"regular, as a light field": (chain, time.perf_counter() - before)}
        for label, photographs, offsets in (
            ("regular", row, even),
            ("every second missing", sparse, even[~second]),
            ("every second moved", uneven, moved),
            ("moved, taken as regular", ignored, even),
        ):
            found[label] = disparity_of(photographs, offsets, regular)
        for label, (disparity, seconds) in found.items():
            scores = depth_scores(disparity, truth.disparity, mask=truth.valid)
            rows.append(
                {
                    "scene": name,
                    "views": label,
                    "MSE*100": float(scores.mse),
                    "Q25*100": float(scores.q25),
                    "BP(.03)": float(scores.bad_03),
                    "BP(.07)": float(scores.bad_07),
                    "seconds with compilation": round(seconds, 1),
                }
            )
            print(rows[-1], flush=True)
        jax.clear_caches()
    print_table(rows, title=f"{arguments.views} views in a row, {arguments.size} px")
    write_csv(arguments.out / "irregular_views.csv", rows)
    write_json(arguments.out / "irregular_views.json", rows)


if __name__ == "__main__":
    main()
