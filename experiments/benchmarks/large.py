"""Depth of images that are larger than the memory allows: seconds and memory by size.

    python experiments/benchmarks/large.py --sizes 512 1024 2048 --out results/benchmark_large
    python experiments/benchmarks/large.py --sizes 4096 --memory 12 --samples 2

The crosshair of 9x9 views of a rendered scene, whose disparities are the same at every size. Every
size runs in a process of its own, whose peak memory counts. With `--pair`, calls of 512 px in one
piece run before and after the second call: the speed of a machine changes within minutes. With
`--compare`, tiles are compared with the whole image in one piece.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments._report import peak_memory, print_table, write_json
from mvedge_jax import EdgeDepth, plotting
from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.synthetic._render import check_grid, grid_pinhole, regular
from mvedge_jax.datasets.synthetic._trace import mode_of, trace_view
from mvedge_jax.datasets.synthetic.world import Scene
from mvedge_jax.depth import DepthResult, estimate_depth
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry.brightness import Known
from mvedge_jax.tiles import StoredViews, Tiling, Window, depth_in_tiles


def main() -> None:
    """Measures every size in a process of its own, or one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/benchmark_large"))
    parser.add_argument("--scene", default="demo")
    parser.add_argument("--sizes", nargs="+", type=int, default=[512, 1024, 2048])
    parser.add_argument("--memory", type=float, default=6.0, help="gigabytes that tiles may take")
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--once", action="store_true", help="no second call, without compilation")
    parser.add_argument("--pair", action="store_true", help="beside calls of 512 px in one piece")
    parser.add_argument("--compare", action="store_true", help="with the whole image, too")
    arguments = parser.parse_args()
    if arguments.once and arguments.pair:
        parser.error("--pair needs the second call, which --once leaves out")
    if len(arguments.sizes) > 1:
        for size in arguments.sizes:
            words = [*sys.argv, "--sizes", str(size)]
            subprocess.run([sys.executable, *words], check=True)
        return
    size = arguments.sizes[0]
    row = measured(arguments, size)
    print_table([row], title=f"{size}x{size} px, 17 views, tiles within {arguments.memory} GB")
    write_json(arguments.out / f"large_{size}.json", row)


def render_stored(
    scene: Scene, *, shape: tuple[int, int, int, int], samples: int, key: jax.Array
) -> tuple[StoredViews, np.ndarray]:
    """The crosshair in 8 bits, and the true disparity; one view at a time is in floating point."""
    rows, columns, height, width = check_grid(shape, samples)
    mode = mode_of(scene, (height, width), samples)
    gain, focus = float(scene.rig.gain), float(scene.rig.focus)
    center = rows // 2, columns // 2
    cross = [
        (v, u) for v in range(rows) for u in range(columns) if center[0] == v or center[1] == u
    ]
    planes, truth = {}, np.empty((height, width), np.float32)
    for v, u in cross:
        pinhole = grid_pinhole(scene, shape, regular(shape, v, u))
        number = np.asarray(v * columns + u, np.int32)
        image, depth, _ = trace_view(scene.world, scene.sensor, pinhole, key, number, mode=mode)
        planes[v, u] = np.round(255 * np.asarray(image)).astype(np.uint8)
        if (v, u) == center:
            truth[...] = gain / np.asarray(depth) - gain / focus
    low, high = (float(end) for end in scene.disparity_range)
    stored = StoredViews(
        planes,
        (rows, columns),
        disparity_range=(low, high),
        camera=scene.rig.camera(height, width),
        name=scene.name,
    )
    return stored, truth


def small_call(arguments: argparse.Namespace) -> Callable[[], float]:
    """A call of `estimate_depth` at 512 px of the same scene, compiled; returns its seconds."""
    stored, _ = render_stored(
        synthetic.scene(arguments.scene),
        shape=(9, 9, 512, 512),
        samples=arguments.samples,
        key=jax.random.key(0),
    )
    light_field = stored.window(Window(0, 0, 512, 512))
    model, bare = EdgeDepth.for_light_field(light_field), light_field.bare()

    def call() -> float:
        start = time.perf_counter()
        jax.block_until_ready(estimate_depth(bare, model))
        return time.perf_counter() - start

    call()
    return call


def measured(arguments: argparse.Namespace, size: int) -> dict[str, float]:
    """One size: seconds, memory, scores; the map as a picture."""
    stored, truth = render_stored(
        synthetic.scene(arguments.scene),
        shape=(9, 9, size, size),
        samples=arguments.samples,
        key=jax.random.key(0),
    )
    rendered = peak_memory()
    tiling, seconds = Tiling.within(1e9 * arguments.memory, views=stored), []

    def estimated() -> DepthResult:
        start = time.perf_counter()
        found = depth_in_tiles(stored, tiling=tiling)
        seconds.append(time.perf_counter() - start)
        return found

    result = estimated()
    peak = peak_memory()
    call = small_call(arguments) if arguments.pair else None
    beside = [call(), call()] if call else []
    if not arguments.once:
        result = estimated()
    beside += [call(), call()] if call else []
    tiles = tiling.of(size, size)
    found = depth_scores(result.disparity, jax.numpy.asarray(truth))
    row = {
        "pixels": float(size * size),
        "tile px": tiles[0].window.height,
        "tiles": len(tiles),
        "first s": seconds[0],
        "later s": seconds[-1],
        "us per pixel": 1e6 * seconds[-1] / size**2,
        "memory after rendering GB": rendered / 1e9,
        "peak memory GB": peak / 1e9,
        "MSE*100": float(found.mse),
        "BP(.07)": float(found.bad_07),
    }
    if beside:
        row["512 px, us per pixel"] = 1e6 * float(np.mean(beside)) / 512**2
        row["ratio"] = row["us per pixel"] / row["512 px, us per pixel"]
    arguments.out.mkdir(parents=True, exist_ok=True)
    disparity = np.asarray(result.disparity)
    plotting.plot_disparity(disparity).savefig(arguments.out / f"large_{size}.png")
    plotting.plot_error(disparity, truth, kind="signed").savefig(
        arguments.out / f"large_{size}_error.png"
    )
    if arguments.compare:
        whole = stored.window(Window(0, 0, size, size))
        # Of the same brightness and noise, which tiles have from small pictures.
        known = Known(result.stats.exposure, result.stats.noise)
        model = EdgeDepth.for_light_field(whole).replace({"calibration.known": known})
        of_whole = jax.block_until_ready(estimate_depth(whole.bare(), model))
        start = time.perf_counter()
        jax.block_until_ready(estimate_depth(whole.bare(), model))
        row["whole, later s"] = time.perf_counter() - start
        apart = np.abs(disparity - np.asarray(of_whole.disparity))
        for share in (50, 90, 99, 99.9):
            row[f"apart, {share} %, px"] = float(np.percentile(apart, share))
        row["apart by more than 1e-5 px, %"] = 100 * float(np.mean(apart > 1e-5))
    return row


if __name__ == "__main__":
    main()
