"""Solids placed by where the picture shows them: in picture widths, and by disparity."""

from ._solids import bar, plane, rotation
from .world import FOCAL, FOCUS, GAIN, Material, Solid, Triple


def depth(disparity: float) -> float:
    """Meters to a point of a disparity."""
    return 1.0 / (disparity / GAIN + 1.0 / FOCUS)


def at(x: float, y: float, disparity: float) -> Triple:
    """The point that the center view sees at `(x, y)`, in picture widths from its middle."""
    z = depth(disparity)
    return x * z / FOCAL, y * z / FOCAL, z


def meters(fraction: float, disparity: float) -> float:
    """Meters that cover a fraction of the picture's width at a disparity."""
    return fraction * depth(disparity) / FOCAL


def card(
    x: float, y: float, disparity: float, size: tuple[float, float], material: Material, **options
) -> Solid:
    """A plane placed and sized in picture widths."""
    extent = (meters(size[0], disparity), meters(size[1], disparity))
    return plane(at(x, y, disparity), extent, material=material, **options)


def wall(disparity: float, material: Material) -> Solid:
    """A plane that faces the camera and fills the picture of every view."""
    return card(0.0, 0.0, disparity, (4.0, 4.0), material)


def floor(y: float, nearest: float, farthest: float, material: Material) -> Solid:
    """A level plane `y` meters below the cameras, between two disparities.

    It ends where the scene's disparity range does: an outer view of a small picture sees its edge,
    not something nearer than the range.
    """
    front, back = depth(nearest), depth(farthest)
    center = (0.0, y, 0.5 * (front + back))
    axes = rotation(pitch=90.0)
    return plane(center, (60.0, back - front), axes=axes, material=material)


def rod(
    start: tuple[float, float, float],
    stop: tuple[float, float, float],
    width: float,
    material: Material,
) -> Solid:
    """A bar between points `(x, y, disparity)`; its width is in picture widths."""
    middle = 0.5 * (start[2] + stop[2])
    return bar(at(*start), at(*stop), 0.5 * meters(width, middle), material=material)
