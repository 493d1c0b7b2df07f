"""For the table of photographs: COLMAP's maps, labels of a dense map, errors as in the thesis."""

import sys
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.peers.photographs import read_colmap_depth, scale_to
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.posed import Photographs, Reference
from mvedge_jax.posed.scores import DepthErrors, depth_errors
from mvedge_jax.posed.sparse import SparseStereoDepth, sparse_stereo

# Labels of a dense map that Ours-C starts from, as many as in the thesis' Figure 7.8.
DENSE = 2808
# Depth by the name of the method.
Maps = dict[str, np.ndarray]


def from_dense(photographs: Photographs, reference: Reference, depth: np.ndarray) -> np.ndarray:
    """The thesis' Ours-C: labels of a dense map at edges of the image, optimized in turns.

    Args:
        photographs: of which one is the reference.
        reference: see `reference_of`.
        depth: of the reference, in the unit of the poses; 0 or not finite where unknown.

    Returns:
        The depth after optimization; without any label at an edge, no pixel has one.
    """
    index = int(reference.index)
    gray = np.asarray(srgb_to_gray(photographs.images[index]))
    edge = cv2.Canny(np.round(255 * gray).astype(np.uint8), 50, 150) > 0
    y, x = np.nonzero(edge & np.isfinite(depth) & (depth > 0))
    if not y.size:
        return np.zeros_like(depth)
    kept = np.random.default_rng(0).permutation(y.size)[:DENSE]
    y, x = y[kept], x[kept]
    pose, matrix = (
        np.asarray(a[index], np.float64) for a in (photographs.poses, photographs.intrinsics)
    )
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(matrix).T
    points = depth[y, x, None] * rays @ pose[:3, :3].T + pose[:3, 3]
    dense = Photographs(
        photographs.images, photographs.poses, photographs.intrinsics, points=points,
        mask=photographs.mask, names=photographs.names, name=photographs.name,
        origin=photographs.origin,
    )  # fmt: skip
    # Nothing is added at edges: the points are there already.
    method = SparseStereoDepth(extra=0)
    return np.asarray(sparse_stereo(dense, reference, method, key=jax.random.key(0)).depth)


def from_colmap(photographs: Photographs, reference: Reference, maps: Path | None) -> Maps:
    """COLMAP's dense map of the reference and Ours-C, if its file is there."""
    if maps is None:
        return {}
    name, shape = photographs.names[int(reference.index)], photographs.images.shape[1:3]
    places = [maps / f"{name}.{kind}.bin" for kind in ("geometric", "photometric")]
    place = next((place for place in places if place.is_file()), None)
    if place is None:
        raise SystemExit(f"--colmap {maps} has neither {places[0].name} nor {places[1].name}.")
    depth = read_colmap_depth(place)
    if depth.shape != shape:
        raise SystemExit(
            f"{place} has {depth.shape[1]}x{depth.shape[0]} px; expected the photographs' "
            f"{shape[1]}x{shape[0]}: undistort them, and do not let COLMAP shrink them."
        )
    return {"COLMAP": depth, "ours-C": from_dense(photographs, reference, depth)}


def as_printed(depth: jax.Array, truth: jax.Array) -> DepthErrors:
    """Errors as in the thesis: unknown pixels at the mean true depth, the least of ten fits."""
    known = jnp.isfinite(depth) & (depth > 0)
    mean = jnp.mean(truth, where=jnp.isfinite(truth) & (truth > 0))

    def fit(seed: int) -> DepthErrors:
        factor = scale_to(depth, truth, key=jax.random.key(seed))
        return depth_errors(jnp.where(known, factor * depth, mean), truth)

    return min(map(fit, range(10)), key=lambda errors: float(errors.mse))
