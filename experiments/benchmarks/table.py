"""Seconds and memory by size: first call, from the cache, later calls, gradient, batches, peers.

    python experiments/benchmarks/table.py --sizes 128 256 512 1024 --out results/benchmark_table

The crosshair of 9x9 views of a rendered scene, 8 bits. First calls, calls from the cache and peak
memory are those of a process of its own; importing and rendering are not counted. In the same run:
the plane sweep of the same views, OpenCV's SGBM of the center view and the outermost one to its
right, and one diffusion of the labels of `diffusion.py` by this library and by PyAMG (classical
coarsening, conjugate gradients, set-up included), both to the same residual. Gradients and batches
are measured up to `--gradient` and `--batch` px. On a GPU, peak memory is that of the card.

Then calls at 256 px by the number of views and by the width of the range that is searched, which
the scene itself fills at a factor of 1.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

# Processes share a GPU.
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments._report import peak_memory, print_table, timed, write_json
from experiments.benchmarks.diffusion import generate, pyamg_cg
from experiments.benchmarks.large import render_stored
from mvedge_jax import EdgeDepth, batched, compilation_cache, describe, lean_jit
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import estimate_depth
from mvedge_jax.diffusion import Multigrid, diffuse
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry.matching import plane_sweep
from mvedge_jax.tiles import StoredViews, Window

SETTINGS = 64
CURVES = 256  # px
# Of one diffusion: relative residual, and largest over smallest smoothness.
RESIDUAL, CONTRAST = 1e-5, 1e4


def main() -> None:
    """Measures every size; every column that needs it in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/benchmark_table"))
    parser.add_argument("--sizes", nargs="*", type=int, default=[128, 256, 512, 1024])
    parser.add_argument("--gradient", type=int, default=512, help="largest side, px")
    parser.add_argument("--batch", type=int, default=128, help="largest side, px")
    parser.add_argument("--views", nargs="*", type=int, default=[3, 5, 9, 17], help="per side")
    parser.add_argument("--ranges", nargs="*", type=float, default=[1, 2, 4], help="factors")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--child", nargs=2, metavar=("WHAT", "FILE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child is not None:
        what, file = arguments.child
        compilation_cache()
        print(json.dumps(CHILDREN[what](*_opened(Path(file)), arguments.repeats)))
        return
    rows = []
    for size in arguments.sizes:
        with tempfile.TemporaryDirectory() as name:
            file, cache = Path(name) / "views.npz", Path(name) / "cache"
            _render(size, file)
            row: dict[str, Any] = {"px": size}
            row |= _child("value", file, arguments.repeats, cache)
            row["from cache s"] = _child("value", file, 0, cache)["first s"]
            if size <= arguments.gradient:
                row |= _child("gradient", file, arguments.repeats)
            if size <= arguments.batch:
                row |= _child("batch", file, arguments.repeats)
            row |= _child("peers", file, arguments.repeats)
        rows.append(row)
        print_table([{"": key, "value": value} for key, value in row.items()], title=f"{size} px")
        # After every size: a run that is stopped leaves what it has.
        write_json(arguments.out / "sizes.json", rows)
    curves = [("views", views, 1.0) for views in arguments.views]
    curves += [("range", 9, factor) for factor in arguments.ranges]
    rows = [_point(*point, repeats=arguments.repeats) for point in curves]
    if rows:
        print_table(rows, title=f"{CURVES} px")
        write_json(arguments.out / "curves.json", rows)


def _point(curve: str, views: int, factor: float, *, repeats: int) -> dict[str, Any]:
    """A point of a curve: views in a row, searched over `factor` times the scene's range."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "views.npz"
        width = _render(CURVES, file, views=views, factor=factor)
        place = {"curve": curve, "views": views, "range px": width}
        return place | _child("value", file, repeats)


def _child(what: str, file: Path, repeats: int, cache: Path | None = None) -> dict[str, Any]:
    """What a process of its own finds; without a compilation cache unless one is named."""
    plain = {name: value for name, value in os.environ.items() if "CACHE" not in name}
    environment = {**plain, "MVEDGE_CACHE": str(cache or "off")}
    words = [sys.argv[0], "--repeats", str(repeats), "--child", what, str(file)]
    done = subprocess.run(
        [sys.executable, *words], env=environment, check=True, stdout=subprocess.PIPE, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def _render(size: int, file: Path, *, views: int = 9, factor: float = 1.0) -> float:
    """Writes views, and a range of `factor` times the width of the scene's own; that width."""
    scene, key = synthetic.scene("demo"), jax.random.key(0)
    stored, truth = render_stored(scene, shape=(views, views, size, size), samples=2, key=key)
    assert stored.disparity_range is not None
    low, high = stored.disparity_range
    middle, half = (low + high) / 2, factor * (high - low) / 2
    places, ends = np.array(list(stored.planes)), np.array([middle - half, middle + half])
    np.savez(
        file,
        places=places,
        ends=ends,
        truth=truth,
        views=[*stored.planes.values()],
        grid=np.array([views, views]),
    )
    return 2 * half


def _opened(file: Path) -> tuple[LightField, np.ndarray]:
    """The crosshair and the true disparity."""
    with np.load(file) as found:
        places = [(int(v), int(u)) for v, u in found["places"]]
        planes = dict(zip(places, found["views"], strict=True))
        low, high = found["ends"].tolist()
        truth, (rows, columns) = found["truth"], found["grid"].tolist()
    stored = StoredViews(
        planes, (rows, columns), disparity_range=(low, high), camera=None, name="demo"
    )
    return stored.window(Window(0, 0, *truth.shape)), truth


def _gigabytes() -> float:
    stats = jax.local_devices()[0].memory_stats() or {}
    return stats.get("peak_bytes_in_use", peak_memory()) / 2**30


def _value(light_field: LightField, truth: np.ndarray, repeats: int) -> dict[str, Any]:
    model = EdgeDepth.for_light_field(light_field)
    found, seconds = timed(estimate_depth, light_field.bare(), model, repeats=repeats)
    score = float(depth_scores(found.disparity, jnp.asarray(truth)).bad_07)
    return {
        "first s": seconds.first,
        "warm s": seconds.median,
        "peak GiB": _gigabytes(),
        "BP(.07)": score,
    }


def _gradient(light_field: LightField, truth: np.ndarray, repeats: int) -> dict[str, Any]:
    """Value and gradient of a loss in all numbers and in the views."""
    bare, model = light_field.bare(), EdgeDepth.for_light_field(light_field)
    target = jnp.asarray(truth)

    def loss(model: EdgeDepth, views: jax.Array) -> jax.Array:
        seen = eqx.tree_at(lambda field: field.views, bare, views)
        return jnp.mean(jnp.abs(model(seen).disparity - target))

    both = lean_jit(jax.value_and_grad(loss, (0, 1)))
    seconds = timed(both, model, bare.views, repeats=repeats)[1]
    return {
        "gradient first s": seconds.first,
        "gradient warm s": seconds.median,
        "gradient peak GiB": _gigabytes(),
    }


def _batch(light_field: LightField, truth: np.ndarray, repeats: int) -> dict[str, Any]:
    """Settings of two numbers of the diffusion, all in one call."""
    bare, model = light_field.bare(), EdgeDepth.for_light_field(light_field)
    names = ("refine.precision", "smoothness.color")
    known = {row.path: row.value for row in describe(model)}

    def one(row: jax.Array, model: EdgeDepth) -> jax.Array:
        varied = model.replace({name: row[i] for i, name in enumerate(names)})
        return estimate_depth(bare, varied).disparity

    factors = np.exp(np.random.default_rng(0).uniform(-0.7, 0.7, (SETTINGS, len(names))))
    settings = jnp.asarray(factors * [known[name] for name in names], jnp.float32)
    seconds = timed(lean_jit(batched(one)), settings, model, repeats=repeats)[1]
    return {"settings per s": SETTINGS / seconds.median, "batch peak GiB": _gigabytes()}


def _peers(light_field: LightField, truth: np.ndarray, repeats: int) -> dict[str, Any]:
    def scored(disparity: Any) -> float:
        return float(depth_scores(jnp.asarray(disparity), jnp.asarray(truth)).bad_07)

    swept, sweep = timed(lambda: plane_sweep(light_field).disparity, repeats=repeats)
    matched, match = timed(lambda: _semi_global(light_field), repeats=repeats)
    system = generate(truth.shape[0], CONTRAST)
    solver = Multigrid(tolerance=RESIDUAL, by_residual=True)
    ours = timed(lambda: diffuse(system, solver=solver).value, repeats=repeats)[1]
    theirs = [pyamg_cg("ruge_stuben_solver")(system, RESIDUAL) for _ in range(repeats + 1)][1:]
    return {
        "sweep s": sweep.median,
        "sweep BP(.07)": scored(swept),
        "SGBM s": match.median,
        "SGBM BP(.07)": scored(matched),
        "diffusion s": ours.median,
        "PyAMG s": statistics.median(answer.setup + answer.solve for answer in theirs),
    }


def _semi_global(light_field: LightField) -> np.ndarray:
    """Disparity, px per view step; what OpenCV leaves out takes the value to its left."""
    row, column = light_field.center
    left, right = (
        np.round(255 * np.asarray(light_field.views[row, u])).astype(np.uint8)
        for u in (column, light_field.views.shape[1] - 1)
    )
    steps = light_field.views.shape[1] - 1 - column
    assert light_field.disparity_range is not None
    low, high = (steps * float(end) for end in light_field.disparity_range)
    first, count = int(np.floor(low)) - 1, 16 * int(np.ceil((high - low + 3) / 16))
    side = 3
    matcher = cv2.StereoSGBM.create(
        minDisparity=first,
        numDisparities=count,
        blockSize=side,
        P1=8 * side**2,
        P2=32 * side**2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    found = matcher.compute(left, right).astype(np.float32) / 16
    known = found >= first
    last = np.maximum.accumulate(np.where(known, np.arange(found.shape[1])[None], 0), axis=1)
    return np.take_along_axis(found, last, 1) / steps


CHILDREN: dict[str, Callable[[LightField, np.ndarray, int], dict[str, Any]]] = {
    "value": _value,
    "gradient": _gradient,
    "batch": _batch,
    "peers": _peers,
}


if __name__ == "__main__":
    main()
