"""Makers of solids: planes, boxes, spheres and bars, placed in the center camera's frame."""

import numpy as np

from .world import Cutout, Material, Solid, Triple

_IDENTITY: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _triple(vector: np.ndarray) -> Triple:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _rows(matrix: np.ndarray) -> tuple[Triple, Triple, Triple]:
    return _triple(matrix[0]), _triple(matrix[1]), _triple(matrix[2])


def rotation(
    *, pitch: float = 0.0, yaw: float = 0.0, roll: float = 0.0
) -> tuple[Triple, Triple, Triple]:
    """Axes of a solid that is rolled about z, then pitched about x, then yawed about y.

    Args:
        pitch: degrees; a plane that faces the camera leans back at the top (its top is farther).
        yaw: degrees; its right side turns away.
        roll: degrees; clockwise in the picture.

    Returns:
        The three orthonormal axes, as rows, in the center camera's frame.

    Example:
        >>> rotation()
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """
    a, b, c = np.deg2rad([pitch, yaw, roll])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, -np.sin(b)], [0, 1, 0], [np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return _rows((about_y @ about_x @ about_z).T + 0.0)


def plane(
    center: Triple,
    size: tuple[float, float],
    *,
    axes: tuple[Triple, Triple, Triple] = _IDENTITY,
    material: Material | None = None,
    cutout: Cutout = "none",
    cutout_size: float = 0.2,
    object_id: int = 0,
) -> Solid:
    """A flat rectangle, perhaps with holes.

    Args:
        center: meters, in the center camera's frame (x right, y down, z forward).
        size: width and height, meters.
        axes: its orientation, see `rotation`; it faces the camera by default.
        material: its surface.
        cutout: `"holes"` (round, staggered), `"slats"` (vertical gaps) or `"leaves"` (irregular).
        cutout_size: period of the holes, meters.
        object_id: what the ground truth calls it; 0 numbers it by its place in the list.

    Returns:
        The solid, for `make_world`.
    """
    half = (size[0] / 2, size[1] / 2, 0.0)
    surface = material or Material()
    return Solid(center, axes, half, False, surface, cutout, cutout_size, object_id)


def box(
    center: Triple,
    size: Triple,
    *,
    axes: tuple[Triple, Triple, Triple] = _IDENTITY,
    material: Material | None = None,
    object_id: int = 0,
) -> Solid:
    """A cuboid.

    Args:
        center: meters, in the center camera's frame (x right, y down, z forward).
        size: meters along its own three axes.
        axes: its orientation, see `rotation`.
        material: its surface.
        object_id: what the ground truth calls it; 0 numbers it by its place in the list.

    Returns:
        The solid, for `make_world`.
    """
    half = (size[0] / 2, size[1] / 2, size[2] / 2)
    return Solid(center, axes, half, False, material or Material(), object_id=object_id)


def sphere(
    center: Triple,
    radius: float,
    *,
    axes: tuple[Triple, Triple, Triple] = _IDENTITY,
    material: Material | None = None,
    object_id: int = 0,
) -> Solid:
    """A ball.

    Args:
        center: meters, in the center camera's frame (x right, y down, z forward).
        radius: meters.
        axes: orientation of its texture, see `rotation`.
        material: its surface.
        object_id: what the ground truth calls it; 0 numbers it by its place in the list.

    Returns:
        The solid, for `make_world`.
    """
    return Solid(
        center, axes, (radius, radius, 0.0), True, material or Material(), object_id=object_id
    )


def bar(
    start: Triple,
    stop: Triple,
    radius: float,
    *,
    material: Material | None = None,
    object_id: int = 0,
) -> Solid:
    """A thin round bar with rounded ends.

    Args:
        start: one end, meters, in the center camera's frame (x right, y down, z forward).
        stop: the other end.
        radius: meters.
        material: its surface.
        object_id: what the ground truth calls it; 0 numbers it by its place in the list.

    Returns:
        The solid, for `make_world`.

    Raises:
        ValueError: if the two points are the same (use `sphere`).
    """
    a, b = np.asarray(start, float), np.asarray(stop, float)
    length = float(np.linalg.norm(b - a))
    if length == 0:
        raise ValueError(f"`start` and `stop` must differ, got {start} for both.")
    along = (b - a) / length
    helper = np.eye(3)[int(np.argmin(np.abs(along)))]
    across = np.cross(helper, along)
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(along, across), along])
    half = (radius, radius, length / 2)
    surface = material or Material()
    return Solid(_triple((a + b) / 2), _rows(axes), half, True, surface, object_id=object_id)
