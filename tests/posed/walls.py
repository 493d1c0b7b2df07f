"""Photographs of textured planes, made without the package: where every pixel is, is known."""

import numpy as np
from scipy import ndimage

SIZE = (36, 48)
MATRIX = np.array([[40.0, 0, 23.5], [0, 40.0, 17.5], [0, 0, 1]])


def turned(yaw=0.0, pitch=0.0, roll=0.0, at=(0.0, 0.0, 0.0)):
    """A pose, camera to world, from angles in degrees."""
    pose = np.eye(4)
    for angle, (i, j) in ((yaw, (2, 0)), (pitch, (1, 2)), (roll, (0, 1))):
        c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = c
        turn[i, j], turn[j, i] = -s, s
        pose[:3, :3] = pose[:3, :3] @ turn
    pose[:3, 3] = at
    return pose


def depth_of_plane(pose, normal, offset, *, matrix=MATRIX, size=SIZE):
    """Depth of the plane `normal . X = offset` at every pixel."""
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    ray = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(matrix).T @ pose[:3, :3].T
    return (offset - normal @ pose[:3, 3]) / (ray @ normal)


def places(pose, depth, *, matrix=MATRIX):
    """World points of a depth map."""
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]].astype(float)
    ray = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(matrix).T
    return (ray * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]


def texture(points, seed=0):
    """A smooth pattern on the plane, colors in [0, 1], by two of the points' coordinates."""
    rng = np.random.default_rng(seed)
    table = ndimage.gaussian_filter(rng.uniform(size=(160, 160, 3)), (1.2, 1.2, 0), mode="wrap")
    table = np.clip((table - 0.5) * 3 + 0.5, 0.02, 0.98)
    place = [points[..., 1] * 30 + 80, points[..., 0] * 30 + 80]
    return np.stack(
        [ndimage.map_coordinates(table[..., c], place, order=3, mode="wrap") for c in range(3)], -1
    ).clip(0, 1)


def wall(poses, *, normal=(0.15, -0.1, 1.0), offset=2.0, matrix=MATRIX, size=SIZE):
    """Images and true depths of a slanted wall, seen from poses."""
    normal = np.asarray(normal) / np.linalg.norm(normal)
    depths = [depth_of_plane(p, normal, offset, matrix=matrix, size=size) for p in poses]
    images = [texture(places(p, d, matrix=matrix)) for p, d in zip(poses, depths, strict=True)]
    return np.stack(images), np.stack(depths)


def falloff(losses, size):
    """What lenses leave of every photograph: all in the middle, `1 - loss` in the corners."""
    height, width = size
    y, x = np.mgrid[:height, :width] - np.reshape([height - 1, width - 1], (2, 1, 1)) / 2
    distance = (y**2 + x**2) / (y**2 + x**2).max()
    return 1 - np.reshape(losses, (-1, 1, 1, 1)) * distance[None, ..., None]


POSES = np.stack(
    [
        turned(),
        turned(yaw=2.0, roll=4.0, at=(0.1, 0.02, 0.01)),
        turned(yaw=-2.0, pitch=1.0, at=(-0.1, 0.03, -0.03)),
        turned(pitch=-2.0, at=(0.02, 0.11, 0.02)),
    ]
)


def room(poses, *, matrix=MATRIX, size=SIZE):
    """Images and true depths of a steep floor in front of a wall, seen from poses."""
    images, depths = [], []
    for pose in poses:
        floor = depth_of_plane(pose, np.array([0.0, 1.0, 0.0]), 0.45, matrix=matrix, size=size)
        back = depth_of_plane(pose, np.array([0.1, 0.0, 1.0]), 2.4, matrix=matrix, size=size)
        near = (floor > 0) & (floor < back)
        depth = np.where(near, floor, back)
        point = places(pose, depth, matrix=matrix)
        # The floor's texture lies in its own plane, and is coarse enough to be seen from afar.
        turned_up = 0.5 * np.stack([point[..., 0], point[..., 2], point[..., 1]], -1)
        images.append(np.where(near[..., None], texture(turned_up, seed=1), texture(point)))
        depths.append(depth)
    return np.stack(images), np.stack(depths)
