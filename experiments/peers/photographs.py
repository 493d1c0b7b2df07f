"""Photographs for Table 7.1: rendered, COLMAP's depth maps, sparse points, free scales."""

import dataclasses
import os
import re
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from mvedge_jax._params import accepts_numpy
from mvedge_jax.datasets.photographs._sift import triangulated
from mvedge_jax.datasets.synthetic._render import check_samples, check_shape, trace_views
from mvedge_jax.datasets.synthetic._trace import Pinhole, mode_of
from mvedge_jax.datasets.synthetic.world import Scene
from mvedge_jax.posed import Photographs

_HEADER = re.compile(rb"(\d{1,9})&(\d{1,9})&(\d{1,9})&")
# Pixels at which the thesis fits a scale.
_SAMPLES = 500
# Places of the cameras in units of the baseline, and no two of them in a row or a column.
_PLACES = (
    (0.0, 0.0, 0.0),
    (0.83, -0.42, 0.12),
    (-0.71, -0.64, -0.1),
    (-0.52, 0.78, 0.08),
    (0.61, 0.7, -0.14),
)
# Turns about the line of sight, degrees.
_ROLLS = (0.0, 3.0, -4.0, 2.0, -2.0)


class PosedViews(NamedTuple):
    """Photographs with known poses: what multi-view stereo starts from.

    Attributes:
        images: sRGB in [0, 1].
        depth: distance along the optical axis of the pixel centers, meters; infinite for the sky.
        object_ids: what the pixel centers see; 0 for the sky.
        poses: camera to world; x right, y down, z forward.
        intrinsics: `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`, px.
    """

    images: Float[Array, "n y x 3"]
    depth: Float[Array, "n y x"]
    object_ids: Int[Array, "n y x"]
    poses: Float[Array, "n 4 4"]
    intrinsics: Float[Array, "n 3 3"]


def render_posed(
    scene: Scene,
    poses: Float[Array, "n 4 4"] | np.ndarray,
    intrinsics: Float[Array, "n 3 3"] | Float[Array, "3 3"] | np.ndarray,
    *,
    size: tuple[int, int],
    samples: int = 3,
    key: PRNGKeyArray,
) -> PosedViews:
    """Renders photographs from anywhere, for multi-view stereo.

    Args:
        scene: what to photograph; meters, in the frame of the light field's center camera.
        poses: camera to world, rigid; x right, y down, z forward.
        intrinsics: `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]` in px, for each view or for all.
        size: height and width, px.
        samples: as for `render`.
        key: draws the sensor's noise.

    Returns:
        Images, depth and object ids of the pixel centers, poses and intrinsics (one per view).

    Raises:
        ValueError: if a shape, a rotation or a size is wrong.
    """
    dtype = np.dtype(scene.world.solids.center.dtype)
    pose = np.asarray(poses, np.float64)
    if pose.ndim != 3 or pose.shape[1:] != (4, 4):
        raise ValueError(f"`poses` must have the shape [n, 4, 4], got {pose.shape}.")
    turn = pose[:, :3, :3]
    if not np.allclose(turn @ turn.transpose(0, 2, 1), np.eye(3), atol=1e-4):
        raise ValueError("`poses` must be rigid (orthonormal rotations), got something else.")
    matrix = np.asarray(intrinsics, np.float64)
    if matrix.shape not in ((3, 3), (len(pose), 3, 3)):
        raise ValueError(
            f"`intrinsics` must have the shape [3, 3] or [{len(pose)}, 3, 3], got {matrix.shape}."
        )
    matrix = np.broadcast_to(matrix, (len(pose), 3, 3))
    check_shape(size, "height, width")
    check_samples(samples)
    pinholes = [
        Pinhole(
            p[:3, 3].astype(dtype),
            p[:3, :3].astype(dtype),
            np.asarray([k[0, 0], k[1, 1]], dtype),
            np.asarray([k[0, 2], k[1, 2]], dtype),
        )
        for p, k in zip(pose, matrix, strict=True)
    ]
    mode = mode_of(scene, (int(size[0]), int(size[1])), samples)
    images, depth, ids = trace_views(scene, pinholes, mode, None, key)
    return PosedViews(
        jnp.asarray(images),
        jnp.asarray(depth),
        jnp.asarray(ids),
        jnp.asarray(pose.astype(dtype)),
        jnp.asarray(matrix.astype(dtype)),
    )


def five_views(
    scene: Scene,
    *,
    size: tuple[int, int],
    baseline: float = 0.25,
    samples: int = 3,
    key: PRNGKeyArray,
) -> Photographs:
    """Renders five unstructured photographs of a scene, with true poses and depth.

    The first one is the light field's center camera; the others stand around it, each at its own
    distance from the scene and turned, and look at the same place.

    Args:
        scene: what to photograph.
        size: height and width, px.
        baseline: from the first camera to the others, about, meters.
        samples: see `render`.
        key: draws the sensor's noise.

    Returns:
        The photographs, meters. Not differentiable.

    Raises:
        ValueError: a size is wrong.

    Source: Thesis 7.2.2, "Datasets": five unstructured views, 25 cm apart.

    Example:
        >>> import jax
        >>> from mvedge_jax.datasets import synthetic
        >>> five = five_views(
        ...     synthetic.scene("edges"), size=(16, 24), samples=1, key=jax.random.key(0)
        ... )
        >>> five.images.shape
        (5, 16, 24, 3)
    """
    target = np.asarray([0.0, 0.0, float(scene.rig.focus)])
    poses = np.stack(
        [
            _looking(baseline * np.asarray(place), target, roll)
            for place, roll in zip(_PLACES, _ROLLS, strict=True)
        ]
    )
    height, width = size
    focal = float(scene.rig.focal) * max(height, width)
    matrix = np.asarray([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    found = render_posed(scene, poses, matrix, size=size, samples=samples, key=key)
    depth = np.asarray(found.depth)
    return Photographs(
        np.clip(np.asarray(found.images), 0, 1),
        found.poses,
        found.intrinsics,
        depth=np.where(np.isfinite(depth), depth, 0),
        name=f"{scene.name}, five views",
    )


def _looking(place: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """A pose at a place that looks at a target, camera to world."""
    ahead = (target - place) / np.linalg.norm(target - place)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    c, s = np.cos(np.deg2rad(roll)), np.sin(np.deg2rad(roll))
    pose = np.eye(4)
    pose[:3, :3] = turn @ np.asarray([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    pose[:3, 3] = place
    return pose


def with_points(photographs: Photographs) -> Photographs:
    """Adds sparse points to photographs.

    Args:
        photographs: with known poses.

    Returns:
        The same with points: SIFT features, matched and triangulated with the poses.
    """
    poses, matrices = (
        np.asarray(values, np.float64) for values in (photographs.poses, photographs.intrinsics)
    )
    mask = None if photographs.mask is None else np.asarray(photographs.mask)
    points, observed = triangulated(np.asarray(photographs.images), poses, matrices, mask)
    return dataclasses.replace(photographs, points=points, observed=observed)


def read_colmap_depth(path: str | os.PathLike) -> Float[np.ndarray, "y x"]:
    """Reads a depth map that COLMAP's `patch_match_stereo` wrote.

    Such files are in `stereo/depth_maps` of a dense workspace, one per undistorted photograph:
    `NAME.photometric.bin` and `NAME.geometric.bin`. A header of text, `width&height&channels&`, is
    followed by little-endian float32 values, row by row.

    Args:
        path: a `.bin` file.

    Returns:
        Distances along the optical axis, in the unit of the model's poses; 0 where COLMAP has none.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it has another header, another number of channels than one, another number of
            bytes than its header says, or values that are no distances.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     place = Path(folder) / "a.png.geometric.bin"
        ...     _ = place.write_bytes(b"2&1&1&" + np.array([1.5, 0.0], "<f4").tobytes())
        ...     read_colmap_depth(place).tolist()
        [[1.5, 0.0]]
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not there; expected a depth map of COLMAP (.bin).")
    data = path.read_bytes()
    header = _HEADER.match(data)
    if header is None:
        raise ValueError(
            f"{path} is not a depth map of COLMAP: expected it to begin with "
            f"'width&height&channels&', found {data[:16]!r}."
        )
    width, height, channels = (int(word) for word in header.groups())
    if channels != 1:
        more = "; three are a map of normals" if channels == 3 else ""
        raise ValueError(f"{path} has {channels} channels; expected one, of depth{more}.")
    if not (width and height):
        raise ValueError(f"{path} has {width}x{height} px; expected at least one.")
    have, need = len(data) - header.end(), 4 * width * height
    if have != need:
        fault = "is truncated" if have < need else "has bytes to spare"
        raise ValueError(
            f"{path} {fault}: expected {need} bytes for {width}x{height} values, found {have}."
        )
    depth = np.frombuffer(data, "<f4", offset=header.end()).reshape(height, width)
    wrong = ~(np.isfinite(depth) & (depth >= 0))
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        raise ValueError(
            f"{path} holds {depth[y, x]} at row {y}, column {x} ({wrong.sum()} such values); "
            "expected distances, finite and at least 0."
        )
    return depth.astype(np.float32)


@accepts_numpy
def scale_to(
    depth: Float[Array, "y x"], truth: Float[Array, "y x"], *, key: PRNGKeyArray
) -> Float[Array, ""]:
    """The factor that brings a depth map closest to the truth, at 500 random pixels.

    Args:
        depth: in any unit.
        truth: not finite or 0 where unknown.
        key: random key of the choice of pixels, among those known in both maps.

    Returns:
        The factor, by least squares. Differentiable in both maps.

    Source: Thesis 7.2.2, "Baselines and Metrics".
    """
    known = (jnp.isfinite(truth) & (truth > 0) & jnp.isfinite(depth) & (depth > 0)).reshape(-1)
    order = jnp.where(known, jax.random.uniform(key, known.shape), jnp.inf)
    chosen = jnp.argsort(order)[: min(_SAMPLES, known.size)]
    weight = known[chosen].astype(depth.dtype)
    own = jnp.where(weight > 0, depth.reshape(-1)[chosen], 1)
    true = jnp.where(weight > 0, truth.reshape(-1)[chosen].astype(depth.dtype), 1)
    return jnp.sum(weight * own * true) / jnp.sum(weight * own**2)
