"""Table 7.1: depth from five posed photographs, with every baseline in the same run.

    python experiments/table_7_1.py --out results/table_7_1
    python experiments/table_7_1.py --scenes livingroom5 --colmap WORKSPACE/stereo/depth_maps

`--colmap` has the depth maps of COLMAP's dense reconstruction, `NAME.geometric.bin` or
`NAME.photometric.bin` for a photograph NAME, of the size and in the unit of the photographs: the
rows "COLMAP" and "ours-C", which starts from 2808 of its labels at edges of the image and is
optimized like the sparse points. COLMAP's dense part needs a GPU and is not run here. What stands
in for it, with `--methods from_sweep`, is our posed plane sweep: row "ours-C, of the sweep".

Errors are in three forms. As they are; after one fit of a scale at 500 pixels (`scaled`); and as in
the thesis (`thesis`): pixels without depth have the mean of the true depth, and the fit of least
MSE counts, of ten fits at 500 other pixels each.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from _photographs import Maps, as_printed, from_colmap, from_dense
from _published import published
from _report import print_table, shared_data, write_csv, write_json
from peers.photographs import five_views, scale_to, with_points
from scipy import interpolate, ndimage

from mvedge_jax.color import srgb_to_gray
from mvedge_jax.datasets import synthetic
from mvedge_jax.datasets.photographs import load_photographs
from mvedge_jax.diffusion import System, diffuse, edge_weights
from mvedge_jax.posed import (
    Photographs,
    Reference,
    StereoDepth,
    posed_sweep,
    reference_of,
    stereo,
)
from mvedge_jax.posed.scores import depth_errors
from mvedge_jax.posed.sparse import (
    SparseStereoDepth,
    seen_points,
    sparse_stereo,
)

Method = Callable[[Photographs, Reference], Maps]
LIVING_ROOM = (525.0, 525.0, 319.5, 239.5)


def ours(photographs: Photographs, reference: Reference) -> Maps:
    """Dense measurement and diffusion, and the hypotheses along paths that it starts from."""
    found = stereo(photographs, reference, StereoDepth.of(reference))
    scale = float(reference.scale(photographs))
    return {
        "ours": np.asarray(found.depth),
        "hypotheses along paths": scale / np.maximum(np.asarray(found.first), 1e-9),
    }


def sweep(photographs: Photographs, reference: Reference) -> Maps:
    """A posed plane sweep."""
    found = posed_sweep(photographs, reference, StereoDepth.of(reference))
    return {"posed plane sweep": np.asarray(found.depth)}


def pixels_of_points(photographs: Photographs, reference: Reference) -> tuple[np.ndarray, ...]:
    """Places `(x, y)` and depths of the sparse points that the reference photograph shows."""
    seen = seen_points(photographs, reference)
    xy, disparity = np.asarray(seen.xy)[seen.valid], np.asarray(seen.disparity)[seen.valid]
    return xy, float(reference.scale(photographs)) / disparity


def linear(photographs: Photographs, reference: Reference) -> Maps:
    """Inverse depths of the points, interpolated linearly; beyond their hull, the nearest."""
    xy, depth = pixels_of_points(photographs, reference)
    height, width = photographs.images.shape[1:3]
    y, x = np.mgrid[:height, :width]
    inner = interpolate.LinearNDInterpolator(xy, 1 / depth)(x, y)
    outer = interpolate.NearestNDInterpolator(xy, 1 / depth)(x, y)
    return {"points, linear": 1 / np.where(np.isfinite(inner), inner, outer)}


def diffusion(photographs: Photographs, reference: Reference) -> Maps:
    """Inverse depths of the points, diffused between the image's edges (7.2), not optimized."""
    xy, depth = pixels_of_points(photographs, reference)
    image = photographs.images[int(reference.index)]
    shape = image.shape[:2]
    last = np.asarray(shape[::-1]) - 1
    column, row = np.clip(np.round(xy).astype(int), 0, last).T
    count, total = np.zeros(shape), np.zeros(shape)
    np.add.at(count, (row, column), 1.0)
    np.add.at(total, (row, column), 1 / depth)
    gray = np.asarray(srgb_to_gray(image))
    # Thesis 7.1.5: Q is the magnitude of the image's gradient; of a Sobel filter here, times 6.
    slope = np.hypot(*(ndimage.sobel(gray, axis) / 4 for axis in (0, 1)))
    smoothness = jnp.asarray(np.exp(-6 * slope), image.dtype)
    system = System(
        jnp.asarray(count > 0, image.dtype),
        jnp.asarray(total / np.maximum(count, 1), image.dtype),
        *edge_weights(smoothness),
    )
    return {"points, diffused": 1 / np.asarray(diffuse(system).value)}


def semiglobal(photographs: Photographs, reference: Reference) -> Maps:
    """OpenCV's SGBM on rectified pairs: the median over the pairs, holes filled by the nearest."""
    index, count = int(reference.index), len(photographs.names)
    maps = [_pair(photographs, reference, i) for i in range(count) if i != index]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pixels that no pair knows
        inverse = np.nanmedian(np.stack(maps), axis=0)
    known = np.isfinite(inverse)
    if not known.any():
        return {"SGBM": np.full(inverse.shape, np.inf)}
    y, x = np.mgrid[: inverse.shape[0], : inverse.shape[1]]
    filled = interpolate.NearestNDInterpolator(np.stack([x[known], y[known]], 1), inverse[known])
    return {"SGBM": 1 / np.where(known, inverse, filled(x, y))}


def _pair(photographs: Photographs, reference: Reference, other: int) -> np.ndarray:
    """Inverse depths of the reference's pixels from one pair; NaN where SGBM finds none."""
    index = int(reference.index)
    poses = np.asarray(photographs.poses, np.float64)
    matrices = np.asarray(photographs.intrinsics, np.float64)
    height, width = photographs.images.shape[1:3]
    # The pair's common axes: x from camera to camera, z as far as it can be that of the reference.
    across = poses[other][:3, 3] - poses[index][:3, 3]
    length = np.linalg.norm(across)
    # SGBM looks for matches to the left: the right camera is the other one.
    x = across / length
    z = poses[index][:3, 2] - (poses[index][:3, 2] @ x) * x
    z /= np.linalg.norm(z)
    turn = np.stack([x, np.cross(z, x), z])
    side = int(1.5 * max(height, width))
    focal = matrices[index][0, 0]
    common = np.asarray([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]])
    pair, maps = [], []
    for i in (index, other):
        mapping = common @ turn @ poses[i][:3, :3] @ np.linalg.inv(matrices[i])
        image = np.round(255 * np.asarray(photographs.images[i])).astype(np.uint8)
        pair.append(cv2.warpPerspective(image, mapping, (side, side)))
        maps.append(mapping)
    low, high = np.asarray(reference.disparity_range, np.float64)
    unit = focal * length / float(reference.scale(photographs))
    least = int(np.floor(low * unit)) - 1
    span = 16 * max(1, int(np.ceil((high * unit + 1 - least) / 16)))
    # Textbook settings for color images and windows of 5 px.
    matcher = cv2.StereoSGBM.create(
        minDisparity=least, numDisparities=span, blockSize=5, P1=8 * 3 * 25, P2=32 * 3 * 25,
        disp12MaxDiff=1, uniquenessRatio=5, speckleWindowSize=100, speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )  # fmt: skip
    found = matcher.compute(*pair).astype(np.float64) / 16
    found[found < least] = np.nan
    rows, columns = np.mgrid[:height, :width]
    place = np.stack([columns, rows, np.ones_like(rows)], -1) @ maps[0].T
    u, v = (np.round(place[..., k] / place[..., 2]).astype(int) for k in (0, 1))
    there = (u >= 0) & (u < side) & (v >= 0) & (v < side)
    disparity = np.where(there, found[np.clip(v, 0, side - 1), np.clip(u, 0, side - 1)], np.nan)
    # Depth along the pair's axis, as depth along the reference's.
    ray = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(matrices[index]).T
    along = ray @ poses[index][:3, :3].T @ z
    inverse = disparity / (focal * length) * along
    return np.where(inverse > 0, inverse, np.nan)


def optimized(photographs: Photographs, reference: Reference) -> Maps:
    """The thesis' method: the points diffused, and optimized with more at the image's edges."""
    found = sparse_stereo(photographs, reference, SparseStereoDepth(), key=jax.random.key(0))
    return {"points, optimized (7.2.2)": np.asarray(found.depth)}


def from_sweep(photographs: Photographs, reference: Reference) -> Maps:
    """Ours-C with the posed plane sweep in the place of COLMAP."""
    (dense,) = sweep(photographs, reference).values()
    return {"ours-C, of the sweep": from_dense(photographs, reference, dense)}


METHODS = {
    method.__name__: method
    for method in (ours, sweep, semiglobal, linear, diffusion, optimized, from_sweep)
}
# The stand-in for COLMAP is asked for by name: it takes as long as all others.
DEFAULT = [name for name in METHODS if name != "from_sweep"]


def scenes(
    data: Path | None, size: int, names: list[str], scale: float
) -> Iterator[tuple[str, Photographs, list[int]]]:
    """Scenes, and the photographs of each that are the reference."""
    folder = None if data is None else data / "mvs" / "livingroom5"
    if folder is not None and folder.is_dir() and (not names or "livingroom5" in names):
        photographs = load_photographs(folder, intrinsics=LIVING_ROOM, scale=scale)
        yield "livingroom5", photographs, list(range(5))
    for name in ("edges", "demo"):
        if names and name not in names:
            continue
        scene = synthetic.scene(name)
        five = five_views(scene, size=(size, size), samples=3, key=jax.random.key(0))
        yield f"{name}, five views", with_points(five), [0]


def scored(
    scene: str, photographs: Photographs, index: int, methods: Sequence[Method]
) -> list[dict]:
    """A row per method; seconds include compilation where the program is new."""
    if photographs.depth is None:
        raise ValueError(f"scene {scene} has no true depth to score against.")
    blind, truth = photographs.without_truth(), photographs.depth[index]
    reference = reference_of(blind, index)
    rows = []
    for method in methods:
        start = time.perf_counter()
        maps = method(blind, reference)
        seconds = time.perf_counter() - start
        for name, depth in maps.items():
            depth = jnp.asarray(depth, truth.dtype)
            found = depth_errors(depth, truth)
            factor = scale_to(depth, truth, key=jax.random.key(index))
            scaled = depth_errors(factor * depth, truth)
            printed = as_printed(depth, truth)
            rows.append(
                {
                    "scene": scene,
                    "reference": index,
                    "method": name,
                    "median %": float(found.median),
                    "above 2 %": float(found.above),
                    "MSE*100": float(found.mse),
                    "Q25*100": float(found.q25),
                    "scaled MSE*100": float(scaled.mse),
                    "scaled Q25*100": float(scaled.q25),
                    "thesis MSE*100": float(printed.mse),
                    "thesis Q25*100": float(printed.q25),
                    "seconds": seconds,
                }
            )
    return rows


def main() -> None:
    """Runs every method on every scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/table_7_1"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="*", default=[])
    parser.add_argument("--size", type=int, default=512, help="side of the rendered scenes, px")
    parser.add_argument("--scale", type=float, default=1.0, help="of the sides of photographs")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=DEFAULT)
    parser.add_argument("--references", type=int, help="so many photographs are the reference")
    parser.add_argument("--colmap", type=Path, help="folder of COLMAP's depth maps")
    arguments = parser.parse_args()
    colmap = partial(from_colmap, maps=arguments.colmap)
    methods = [*(METHODS[name] for name in arguments.methods), colmap]
    rows: list[dict] = []
    found = scenes(arguments.data, arguments.size, arguments.scenes, arguments.scale)
    for scene, photographs, indices in found:
        for index in indices[: arguments.references]:
            rows += scored(scene, photographs, index, methods)
            write_csv(arguments.out / "table_7_1.csv", rows)
            write_json(arguments.out / "table_7_1.json", rows)
        mine = [row for row in rows if row["scene"] == scene]
        means: list[dict] = []
        for name in dict.fromkeys(row["method"] for row in mine):
            chosen = [row for row in mine if row["method"] == name]
            numbers = {k: float(np.mean([row[k] for row in chosen])) for k in list(mine[0])[3:]}
            means.append({"method": name, **numbers})
        print_table(mine, title=scene)
        print_table(means, title=f"{scene}: mean over the references")
    print_table(published("7.1"), title="thesis, Tab. 7.1: scenes that were not published")


if __name__ == "__main__":
    main()
