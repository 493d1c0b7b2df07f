"""What random scenes are furnished with: surfaces, backgrounds and objects, drawn one by one."""

import colorsys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from . import _placing as place
from ._solids import bar, box, plane, rotation, sphere
from .world import Cutout, Material, Pattern, Solid, Triple

_PATTERNS: tuple[Pattern, ...] = ("checks", "bricks", "stripes", "dots")
_CUTOUTS: tuple[Cutout, ...] = ("holes", "slats", "leaves")


@dataclass(frozen=True)
class Dice:
    """Random choices, by a generator of NumPy."""

    rng: np.random.Generator

    def even(self, low: float, high: float) -> float:
        """A number between two ends."""
        return float(self.rng.uniform(low, high))

    def log(self, low: float, high: float) -> float:
        """A number between two ends, even in the logarithm."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def chance(self, share: float) -> bool:
        """True in a share of all cases."""
        return bool(self.rng.random() < share)

    def index(self, count: int) -> int:
        """A whole number below a count."""
        return int(self.rng.integers(count))


class Room(NamedTuple):
    """Where objects may stand.

    Attributes:
        far: disparity of the wall behind everything, of the rig of `_placing`.
        near: disparity that nothing exceeds.
        ground: meters of the floor below the cameras; None if there is no floor.
        theme: a surface that others may share, so that neighbors have one color.
    """

    far: float
    near: float
    ground: float | None
    theme: Material


def material(dice: Dice, theme: Material | None = None) -> Material:
    """A surface: from plain paint to fine texture, perhaps with a pattern, gloss or a mirror.

    Some are made of the `theme`.
    """
    if theme is not None and dice.chance(0.12):
        return theme
    dark, light = _two_colors(dice)
    contrast = 0.0 if dice.chance(0.16) else dice.log(0.1, 1.4)
    found = Material(
        dark=dark,
        light=light if contrast else dark,
        contrast=contrast,
        grain=dice.log(0.04, 1.2),
        gain=dice.even(0.5, 0.8),
        stretch=(dice.log(2.0, 10.0), 1.0, 1.0) if dice.chance(0.2) else (1.0, 1.0, 1.0),
    )
    if dice.chance(0.4):
        found = replace(
            found,
            pattern=_PATTERNS[dice.index(len(_PATTERNS))],
            accent=_color(dice),
            size=dice.log(0.07, 0.5),
            aspect=dice.even(1.5, 5.0),
            tint=dice.even(0.0, 0.6),
        )
    if dice.chance(0.3):
        found = replace(found, specular=dice.even(0.2, 0.9), shininess=dice.log(20.0, 200.0))
    if dice.chance(0.25):
        found = replace(found, mirror=dice.log(0.04, 0.9))
    return found


def _color(dice: Dice) -> Triple:
    saturation = dice.even(0.0, 1.0) ** 1.6
    return colorsys.hsv_to_rgb(dice.even(0.0, 1.0), 0.9 * saturation, dice.even(0.15, 0.95))


def _two_colors(dice: Dice) -> tuple[Triple, Triple]:
    """Two shades of one color, or two colors."""
    if dice.chance(0.2):
        return _color(dice), _color(dice)
    hue, saturation = dice.even(0.0, 1.0), 0.85 * dice.even(0.0, 1.0) ** 1.6
    dark = dice.even(0.1, 0.55)
    light = min(dark + dice.even(0.12, 0.5), 0.97)
    return (
        colorsys.hsv_to_rgb(hue, saturation, dark),
        colorsys.hsv_to_rgb((hue + dice.even(-0.06, 0.06)) % 1, 0.8 * saturation, light),
    )


def background(dice: Dice, far: float, near: float) -> tuple[list[Solid], Room]:
    """A wall at a disparity, perhaps a floor, side walls, a ceiling or slanted walls.

    Nothing exceeds the disparity `near`. Returns the solids, and where objects may stand.
    """
    theme = material(dice)
    solids = [place.wall(far, theme if dice.chance(0.3) else material(dice))]
    ground = None
    if dice.chance(0.6):
        # Its front edge is a table's within the picture, and below the picture otherwise.
        ground = dice.even(0.36, 0.62) * place.meters(1.0, near)
        solids.append(place.floor(ground, near, far, material(dice, theme)))
    if dice.chance(0.3):
        sides = (-1.0,) if dice.chance(0.4) else (-1.0, 1.0)
        solids += [_side_wall(dice, side, far, near, material(dice, theme)) for side in sides]
    if dice.chance(0.15):
        above = dice.even(-0.7, -0.45) * place.meters(1.0, near)
        solids.append(place.floor(above, near, far, material(dice, theme)))
    if dice.chance(0.45):
        solids.append(_slope(dice, far, near, material(dice, theme)))
    if dice.chance(0.2):
        solids.append(_column(dice, far, near, material(dice, theme)))
    return solids, Room(far, near, ground, theme)


def _side_wall(dice: Dice, side: float, far: float, near: float, surface: Material) -> Solid:
    front, back = place.depth(near), place.depth(far)
    middle = (side * dice.even(0.24, 0.4) * back, 0.0, 0.5 * (front + back))
    axes = rotation(yaw=side * -dice.even(60.0, 86.0))
    return plane(middle, (2.0 * (back - front), 8.0), axes=axes, material=surface)


def _slope(dice: Dice, far: float, near: float, surface: Material) -> Solid:
    """A large slanted plane across the background."""
    disparity = far + dice.even(0.1, 0.35) * (near - far)
    axes = rotation(
        yaw=dice.even(-55.0, 55.0), pitch=dice.even(-55.0, 55.0), roll=dice.even(0.0, 90.0)
    )
    size = (dice.even(0.6, 3.0), dice.even(0.6, 3.0))
    where = dice.even(-0.3, 0.3), dice.even(-0.3, 0.3)
    return place.card(*where, disparity, size, surface, axes=axes)


def _column(dice: Dice, far: float, near: float, surface: Material) -> Solid:
    """A thick round bar across the picture."""
    disparity = far + dice.even(0.2, 0.5) * (near - far)
    angle, x, y = dice.even(0.0, np.pi), dice.even(-0.4, 0.4), dice.even(-0.4, 0.4)
    dx, dy = 1.2 * np.cos(angle), 1.2 * np.sin(angle)
    ends = (x - dx, y - dy, disparity), (x + dx, y + dy, disparity)
    return place.rod(*ends, dice.even(0.15, 0.6), surface)


def thing(dice: Dice, room: Room) -> list[Solid]:
    """The solids of an object, or of a few that belong together."""
    weights = np.asarray([2.0 if kind in (_ball, _chest) else 1.0 for kind in _KINDS])
    kind = _KINDS[int(dice.rng.choice(len(_KINDS), p=weights / weights.sum()))]
    share = dice.even(0.08, 0.97) ** dice.even(0.8, 1.4)
    disparity = room.far + share * (room.near - room.far)
    return kind(dice, room, dice.even(-0.5, 0.5), disparity)


def _axes(dice: Dice, most: float) -> tuple[Triple, Triple, Triple]:
    pitch, yaw = dice.even(-most, most), dice.even(-most, most)
    return rotation(pitch=pitch, yaw=yaw, roll=dice.even(-90.0, 90.0))


def _standing(dice: Dice, room: Room, x: float, disparity: float, half: float) -> Triple:
    """The middle of an object of half a height: on the floor as a rule, or in the air."""
    point = place.at(x, dice.even(-0.45, 0.45), disparity)
    if room.ground is None or dice.chance(0.25):
        return point
    return point[0], room.ground - half, point[2]


def _ball(dice: Dice, room: Room, x: float, disparity: float) -> list[Solid]:
    radius = place.meters(dice.log(0.03, 0.2), disparity)
    middle = _standing(dice, room, x, disparity, radius)
    return [sphere(middle, radius, axes=_axes(dice, 80.0), material=material(dice, room.theme))]


def _chest(dice: Dice, room: Room, x: float, disparity: float) -> list[Solid]:
    """A box, or a pile of up to four."""
    size = [place.meters(dice.log(0.08, 0.35), disparity) for _ in range(3)]
    count = 1 if dice.chance(0.6) else 2 + dice.index(3)
    if count > 1:
        size[1] *= 0.5
    middle, found = _standing(dice, room, x, disparity, size[1] / 2), []
    upright = dice.chance(0.75) or count > 1
    for _ in range(count):
        axes = rotation(yaw=dice.even(-60.0, 60.0)) if upright else _axes(dice, 60.0)
        extent = (size[0], size[1], size[2])
        found.append(box(middle, extent, axes=axes, material=material(dice, room.theme)))
        middle = (middle[0], middle[1] - size[1], middle[2])
        size[0], size[2] = size[0] * dice.even(0.7, 1.0), size[2] * dice.even(0.7, 1.0)
    return found


def _card(dice: Dice, room: Room, x: float, disparity: float) -> list[Solid]:
    """A flat card, facing the camera or slanted."""
    axes = rotation(roll=dice.even(-45.0, 45.0)) if dice.chance(0.35) else _axes(dice, 65.0)
    size = (dice.log(0.06, 0.5), dice.log(0.06, 0.5))
    y, surface = dice.even(-0.5, 0.5), material(dice, room.theme)
    return [place.card(x, y, disparity, size, surface, axes=axes)]


def _screen(dice: Dice, room: Room, x: float, disparity: float) -> list[Solid]:
    """A plane with holes, a fence, or leaves."""
    size = (dice.even(0.2, 0.7), dice.even(0.2, 0.6))
    options = {
        "axes": rotation(yaw=dice.even(-35.0, 35.0), roll=dice.even(-90.0, 90.0)),
        "cutout": _CUTOUTS[dice.index(len(_CUTOUTS))],
        "cutout_size": place.meters(dice.log(0.05, 0.2), disparity),
    }
    y, surface = dice.even(-0.4, 0.4), material(dice, room.theme)
    return [place.card(x, y, disparity, size, surface, **options)]


def _rods(dice: Dice, room: Room, x: float, disparity: float) -> list[Solid]:
    """One to three thin bars, down to half a pixel of 96."""
    found = []
    for _ in range(1 + dice.index(3)):
        angle, length = dice.even(0.0, np.pi), dice.even(0.2, 1.0)
        dx, dy = 0.5 * length * np.cos(angle), 0.5 * length * np.sin(angle)
        y, surface = dice.even(-0.4, 0.4), material(dice, room.theme)
        lean = dice.even(-0.15, 0.15) * (room.near - room.far)
        ends = (x - dx, y - dy, disparity - lean), (x + dx, y + dy, disparity + lean)
        found.append(place.rod(*ends, dice.log(0.005, 0.04), surface))
        x += dice.even(-0.15, 0.15)
    return found


def _plant(dice: Dice, room: Room, x: float, disparity: float) -> list[Solid]:
    """A vase with twigs that end in berries."""
    radius = place.meters(dice.log(0.04, 0.09), disparity)
    foot = _standing(dice, room, x, disparity, radius)
    bark, fruit = material(dice, room.theme), material(dice, room.theme)
    found = [sphere(foot, radius, material=material(dice, room.theme))]
    for _ in range(2 + dice.index(2)):
        rise, aside = dice.even(2.0, 7.0) * radius, dice.even(-3.0, 3.0) * radius
        tip = (foot[0] + aside, foot[1] - rise, foot[2] + dice.even(-1.0, 1.0) * radius)
        found.append(bar(foot, tip, dice.even(0.04, 0.12) * radius, material=bark))
        found.append(sphere(tip, dice.even(0.15, 0.4) * radius, material=fruit))
    return found


_KINDS: tuple[Callable[[Dice, Room, float, float], list[Solid]], ...] = (
    _ball,
    _chest,
    _card,
    _screen,
    _rods,
    _plant,
)
