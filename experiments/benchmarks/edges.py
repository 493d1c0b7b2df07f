"""Time and memory of the point stage, step by step, beside SciPy and OpenCV on the same bank.

python experiments/benchmarks/edges.py
python experiments/benchmarks/edges.py --scene ../shared/data/hci/cotton
"""

import sys
import time
from pathlib import Path
from typing import Any

import cv2
import jax.numpy as jnp
import numpy as np
import tyro
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments._report import peak_memory, print_table, timed, write_json
from mvedge_jax import lean_jit
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.epi import FilterBank, strongest_response
from mvedge_jax.lightfield import LightField


def textured(size: int, views: int = 9) -> LightField:
    """A light field of smoothed noise on a slanted plane: as many edges as a busy photograph."""
    rng = np.random.default_rng(0)
    base = ndimage.gaussian_filter(rng.normal(size=(size + 80, size + 80, 3)), (1.0, 1.0, 0))
    base = np.clip(0.5 + 0.5 * base, 0, 1).astype(np.float32)
    y, x = np.mgrid[0:size, 0:size].astype(np.float32)
    image = np.zeros((views, views, size, size, 3), np.float32)
    center = views // 2
    slope = 2.0 / size
    for v, u in np.ndindex(views, views):
        if center not in (v, u):
            continue
        # Solve x' = x + (u_c - u) d(x) for the plane d = slope * (x - size / 2).
        source = (x + (center - u) * slope * size / 2) / (1 + (center - u) * slope)
        d = slope * (source - size / 2)
        at_y = y - (center - v) * d
        image[v, u] = cv2.remap(base, source + 40, at_y + 40, cv2.INTER_CUBIC)
    available = np.zeros((views, views), bool)
    available[center] = available[:, center] = True
    return LightField(
        jnp.asarray(np.clip(image, 0, 1)), available=available, disparity_range=(-1.2, 1.2)
    )


def _banks(light_field: LightField, model: EdgeDepth) -> tuple[FilterBank, FilterBank]:
    assert isinstance(model.edges, OrientedEdges)
    return model.edges.prewitt(light_field.views.shape)


def _responses_only(light_field: LightField, model: EdgeDepth) -> Any:
    """The largest response over the filters at every pixel, both directions."""
    banks = _banks(light_field, model)
    down = jnp.swapaxes(light_field.vertical_arm, 1, 2)
    return (
        strongest_response(srgb_to_lab(light_field.horizontal_arm), banks[0]),
        strongest_response(srgb_to_lab(down), banks[1]),
    )


def _first_map(light_field: LightField, model: EdgeDepth) -> Any:
    """Exposure, noise and hypotheses."""
    return model.calibration(light_field.without_truth(), model.searched)


def _peers(light_field: LightField, bank: FilterBank, rows: int) -> dict:
    """The same 2-D filters over a few EPIs of one direction, scaled to all EPIs of both."""
    taps = np.asarray(bank.taps, np.float32)
    epis = np.asarray(srgb_to_lab(light_field.horizontal_epis()[:rows]), np.float32)
    height, width = light_field.views.shape[2:4]
    scale = (height + width) / rows
    seconds = {}
    for name in ("OpenCV filter2D", "SciPy ndimage.correlate"):
        start = time.perf_counter()
        for epi in epis:
            for kernel in taps:
                if name.startswith("OpenCV"):
                    cv2.filter2D(epi, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE)
                else:
                    for channel in range(epi.shape[2]):
                        ndimage.correlate(epi[..., channel], kernel, mode="nearest")
        seconds[name] = scale * (time.perf_counter() - start)
    return seconds


def main(
    *,
    scene: Path | None = None,
    size: int = 512,
    repeats: int = 5,
    peer_rows: int = 2,
    out: Path = Path("results/benchmarks/edges"),
) -> None:
    """Times the stages.

    Args:
        scene: a light field to use; a textured slanted plane if not given.
        size: side of the made one, px.
        repeats: warm runs.
        peer_rows: EPIs that the peers filter; their time is scaled to all.
        out: folder for the JSON file.
    """
    light_field = textured(size) if scene is None else load_light_field(scene).without_truth()
    model = EdgeDepth.for_light_field(light_field)
    bank, _ = _banks(light_field, model)
    rows = []
    for name, stage in (
        ("filter responses, both directions", _responses_only),
        ("brightness, noise, first map", _first_map),
        ("multiview_edges: everything", multiview_edges),
    ):
        _, t = timed(lean_jit(stage), light_field, model, repeats=repeats)
        compiling = t.first - t.median
        rows.append({"stage": name, "median s": t.median, "best s": t.best, "compile s": compiling})
    ours = rows[0]["best s"]
    for name, seconds in _peers(light_field, bank, peer_rows).items():
        label = f"{name}: same bank, from {peer_rows} EPIs"
        rows.append({"stage": label, "median s": seconds, "best s": seconds, "compile s": None})
        rows[-1]["stage"] += f"; {seconds / ours:.0f} times ours"
    memory = peak_memory() / 2**30
    print_table(rows, title=f"{light_field.views.shape[:4]}, {len(bank.taps)} filters")
    sys.stdout.write(f"peak memory of the process: {memory:.2f} GiB\n")
    write_json(out / "edges.json", {"stages": rows, "peak memory GiB": memory})


if __name__ == "__main__":
    tyro.cli(main)
