"""Sparse points: SIFT features, matched and triangulated with known poses."""

import itertools
from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

# A match is kept if the second best is this much farther away (Lowe, 2004).
_RATIO = 0.75
# Largest reprojection error of a point, px.
_OFF = 1.5
# Least angle between two lines of sight of a point, radians.
_ANGLE = 0.004
_FEATURES = 4000
# Distance of features from transparent pixels, px.
_OUTLINE = 4


def triangulated(
    images: Float[np.ndarray, "n y x 3"],
    poses: Float[np.ndarray, "n 4 4"],
    intrinsics: Float[np.ndarray, "n 3 3"],
    mask: Bool[np.ndarray, "n y x"] | None = None,
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, "n m"]]:
    """Points that several photographs without distortion show, and which of them show each.

    Features are restricted to the opaque pixels of `mask`.
    """
    features = [
        _features(image, None if mask is None else mask[i]) for i, image in enumerate(images)
    ]
    count = len(images)
    cameras = [k @ np.linalg.inv(pose)[:3] for k, pose in zip(intrinsics, poses, strict=True)]
    # Features are numbered through all photographs.
    everywhere = np.concatenate([place for place, _ in features])
    first = np.cumsum([0, *(len(place) for place, _ in features)])
    pairs = [np.zeros((0, 2), int)]
    for i, j in itertools.combinations(range(count), 2):
        line = _fundamental(poses[i], intrinsics[i], poses[j], intrinsics[j])
        found = np.asarray(_matches(features[i], features[j], line), int).reshape(-1, 2)
        pairs.append(found + first[[i, j]])
    points, seen = [], []
    for members in _groups(np.concatenate(pairs), len(everywhere)):
        views = (np.searchsorted(first, members, side="right") - 1).tolist()
        # Two features of one photograph in a group: something in it is wrong.
        if len(set(views)) < len(views):
            continue
        places = everywhere[members]
        point = _triangulate(places, [cameras[view] for view in views])
        if _good(point, places, views, cameras, poses):
            points.append(point)
            seen.append(np.isin(np.arange(count), views))
    if not points:
        return np.zeros((0, 3)), np.zeros((count, 0), bool)
    return np.stack(points), np.stack(seen, axis=1)


def _features(image: np.ndarray, mask: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    gray = cv2.cvtColor(np.round(255 * image).astype(np.uint8), cv2.COLOR_RGB2GRAY)
    # Without the last option, enlarging the image moves all features by a quarter of a pixel.
    detector = cv2.SIFT.create(
        nfeatures=_FEATURES, contrastThreshold=0.02, enable_precise_upscale=True
    )
    allowed = None
    if mask is not None:
        # The outline of a cutout is not a feature.
        allowed = cv2.erode(255 * mask.astype(np.uint8), np.ones((2 * _OUTLINE + 1,) * 2, np.uint8))
    found, descriptors = detector.detectAndCompute(gray, allowed)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    # RootSIFT (Arandjelovic and Zisserman, 2012) compares better.
    descriptors = descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9)
    return np.asarray([f.pt for f in found], np.float64), np.sqrt(descriptors).astype(np.float32)


def _matches(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], line: np.ndarray
) -> list[tuple[int, int]]:
    """Pairs of features that are each other's best, and on each other's epipolar lines."""
    (place, own), (other_place, other) = first, second
    if min(len(own), len(other)) < 2:
        return []
    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def best(a: np.ndarray, b: np.ndarray) -> dict[int, int]:
        return {
            pair[0].queryIdx: pair[0].trainIdx
            for pair in matcher.knnMatch(a, b, k=2)
            if len(pair) == 2 and pair[0].distance < _RATIO * pair[1].distance
        }

    forward, backward = best(own, other), best(other, own)
    pairs = [(a, b) for a, b in forward.items() if backward.get(b) == a]
    kept = []
    for a, b in pairs:
        p, q = np.append(place[a], 1), np.append(other_place[b], 1)
        there, here = line @ p, line.T @ q
        steep = there[0] ** 2 + there[1] ** 2 + here[0] ** 2 + here[1] ** 2
        off = (q @ there) ** 2 / max(steep, 1e-18)
        if off < _OFF**2:
            kept.append((a, b))
    return kept


def _fundamental(
    pose: np.ndarray, matrix: np.ndarray, other_pose: np.ndarray, other_matrix: np.ndarray
) -> np.ndarray:
    """The matrix that maps a pixel of the first photograph to its line in the second."""
    moved = np.linalg.inv(other_pose) @ pose
    x, y, z = moved[:3, 3]
    cross = np.asarray([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    essential = cross @ moved[:3, :3]
    return np.linalg.inv(other_matrix).T @ essential @ np.linalg.inv(matrix)


def _triangulate(places: np.ndarray, cameras: list[np.ndarray]) -> np.ndarray:
    """The point of least algebraic error, weighted by depth once."""
    weight = np.ones(len(places))
    point = np.zeros(3)
    for _ in range(2):
        rows = [
            w * (place[axis] * camera[2] - camera[axis])
            for place, camera, w in zip(places, cameras, weight, strict=True)
            for axis in (0, 1)
        ]
        _, _, right = np.linalg.svd(np.stack(rows))
        if abs(right[-1, 3]) < 1e-12:
            return np.full(3, np.nan)
        point = right[-1, :3] / right[-1, 3]
        depths = np.asarray([camera[2, :3] @ point + camera[2, 3] for camera in cameras])
        weight = 1 / np.maximum(np.abs(depths), 1e-9)
    return point


def _good(
    point: np.ndarray,
    places: np.ndarray,
    views: list[int],
    cameras: list[np.ndarray],
    poses: np.ndarray,
) -> bool:
    """Whether points are in front of their cameras, reproject well, and have enough parallax."""
    if not np.isfinite(point).all():
        return False
    for place, view in zip(places, views, strict=True):
        x, y, z = cameras[view] @ np.append(point, 1)
        if z <= 0 or np.hypot(x / z - place[0], y / z - place[1]) > _OFF:
            return False
    rays = np.stack([point - poses[view][:3, 3] for view in views])
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return bool(np.arccos(np.clip((rays @ rays.T).min(), -1, 1)) > _ANGLE)


def _groups(pairs: np.ndarray, count: int) -> Iterator[np.ndarray]:
    """Numbers of features that are the same point, by their matches; each in order."""
    if not len(pairs):
        return
    matches = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(count, count))
    group = connected_components(matches, directed=False)[1]
    order = np.argsort(group, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        if len(members) > 1:
            yield members
