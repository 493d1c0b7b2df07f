"""Scenes with a name, each of which stresses one thing."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from . import _placing as place
from ._make import make_scene, make_world
from ._materials import (
    BLUE,
    BRICK,
    CHECKS,
    DOTS,
    MARBLE,
    MOSS,
    OCHRE,
    PLASTER,
    RED,
    SAND,
    SLATE,
    STRIPES,
    WOOD,
)
from ._solids import bar, box, plane, rotation, sphere
from .world import Material, Scene, Solid, Triple


class _Recipe(NamedTuple):
    """What a named scene is made from, before it becomes arrays."""

    solids: Sequence[Solid]
    disparity_range: tuple[float, float]
    shadow: float = 1.0
    softness: float = 0.02
    lamp: Triple = (-0.45, -0.8, -0.6)
    blur: float = 0.0
    read_noise: float = 0.0
    shot_noise: float = 0.0


def _slanted() -> _Recipe:
    floor = place.floor(1.02, 2.2, -2.0, CHECKS)
    left = plane((-1.62, 0.0, 4.6), (4.4, 5.0), axes=rotation(yaw=68.0), material=BRICK)
    right = plane((1.75, 0.0, 4.6), (4.4, 5.0), axes=rotation(yaw=-62.0), material=PLASTER)
    back = plane((0.0, 0.0, 6.2), (9.0, 6.0), axes=rotation(yaw=6.0, pitch=-9.0), material=SLATE)
    cards = [
        place.card(-0.12, -0.14, 0.2, (0.34, 0.3), DOTS, axes=rotation(yaw=48.0, roll=8.0)),
        place.card(0.17, 0.1, 0.7, (0.3, 0.34), MARBLE, axes=rotation(yaw=-40.0, pitch=22.0)),
        place.card(-0.2, 0.2, 0.9, (0.22, 0.2), MOSS, axes=rotation(pitch=55.0, roll=-12.0)),
        place.card(0.2, -0.28, 0.3, (0.3, 0.16), OCHRE, axes=rotation(pitch=-50.0, roll=10.0)),
    ]
    return _Recipe([floor, left, right, back, *cards, place.wall(-2.2, SLATE)], (-2.3, 2.3))


def _edges() -> _Recipe:
    solids = [
        place.wall(-1.2, BRICK),
        place.card(-0.24, -0.2, -0.5, (0.34, 0.3), MARBLE),
        place.card(0.22, -0.22, 0.0, (0.26, 0.34), DOTS, axes=rotation(roll=18.0)),
        place.card(0.02, 0.02, 0.5, (0.24, 0.24), OCHRE, axes=rotation(roll=45.0)),
        place.card(-0.26, 0.25, 0.9, (0.32, 0.24), CHECKS, axes=rotation(roll=-9.0)),
        place.card(0.27, 0.24, 1.4, (0.26, 0.3), STRIPES, axes=rotation(roll=7.0)),
        sphere(place.at(0.0, 0.33, 1.2), place.meters(0.085, 1.2), material=BLUE),
        sphere(place.at(-0.03, -0.33, 0.6), place.meters(0.075, 0.6), material=MOSS),
    ]
    return _Recipe(solids, (-1.3, 1.9))


def _thin() -> _Recipe:
    widths = (0.003, 0.005, 0.008, 0.012, 0.018)
    verticals = [
        place.rod((-0.44 + 0.075 * k, -0.5, 1.0), (-0.4 + 0.075 * k, 0.12, 0.8), width, material)
        for k, (width, material) in enumerate(
            zip(widths, (SAND, RED, STRIPES, OCHRE, MARBLE), strict=True)
        )
    ]
    slanted = [
        place.rod((0.02, -0.46, 1.5), (0.48, -0.3, 0.4), 0.006, OCHRE),
        place.rod((0.05, -0.24, 0.4), (0.48, -0.46, 1.4), 0.01, RED),
        place.rod((0.04, -0.5, 0.9), (0.34, -0.12, 0.9), 0.004, SAND),
    ]
    screens = [
        place.card(0.27, 0.04, 0.6, (0.42, 0.22), MARBLE, cutout="holes", cutout_size=0.13),
        place.card(-0.22, 0.32, 1.2, (0.5, 0.28), MOSS, cutout="leaves", cutout_size=0.26),
        place.card(0.27, 0.34, 1.0, (0.36, 0.22), WOOD, cutout="slats", cutout_size=0.12),
    ]
    return _Recipe([place.wall(-1.07, SLATE), *verticals, *slanted, *screens], (-1.1, 1.6))


def _textureless() -> _Recipe:
    def paint(color: Triple) -> Material:
        return Material(dark=color, light=color, contrast=0.0)

    wall = Material(dark=(0.7, 0.68, 0.63), light=(0.74, 0.72, 0.68), contrast=0.5, grain=2.5)
    solids = [
        place.wall(-1.2, wall),
        place.floor(1.02, 2.2, -1.2, paint((0.6, 0.6, 0.58))),
        sphere(
            place.at(-0.22, 0.12, 0.6), place.meters(0.17, 0.6), material=paint((0.75, 0.35, 0.25))
        ),
        sphere(
            place.at(0.1, 0.27, 1.3), place.meters(0.09, 1.3), material=paint((0.92, 0.85, 0.55))
        ),
        box(
            (0.75, 0.4, 4.2),
            (0.75, 1.1, 0.75),
            axes=rotation(yaw=34.0),
            material=paint((0.36, 0.5, 0.62)),
        ),
        place.card(
            -0.02, -0.24, 0.0, (0.5, 0.2), paint((0.45, 0.55, 0.42)), axes=rotation(roll=-6.0)
        ),
    ]
    return _Recipe(solids, (-1.4, 2.3), softness=0.05)


def _wide() -> _Recipe:
    solids = [
        place.wall(-3.45, PLASTER),
        place.floor(1.35, 1.2, -3.45, CHECKS),
        place.card(-0.27, -0.1, -2.4, (0.28, 0.5), BRICK),
        box(place.at(0.26, -0.02, -1.2), (1.1, 1.6, 1.1), axes=rotation(yaw=28.0), material=WOOD),
        sphere(place.at(-0.05, -0.22, 0.0), place.meters(0.12, 0.0), material=BLUE),
        place.card(-0.2, 0.22, 1.4, (0.26, 0.22), DOTS, axes=rotation(roll=10.0)),
        sphere(place.at(0.12, 0.2, 2.3), place.meters(0.1, 2.3), material=MOSS),
        place.rod((-0.46, -0.46, 3.4), (-0.3, 0.5, 3.0), 0.03, STRIPES),
        place.card(0.36, 0.35, 3.4, (0.18, 0.18), OCHRE, axes=rotation(roll=-14.0)),
    ]
    return _Recipe(solids, (-3.6, 3.6), shadow=0.0)


def _noisy() -> _Recipe:
    return _still_life()._replace(blur=0.6, read_noise=0.02, shot_noise=0.0008)


def _specular() -> _Recipe:
    def glossy(material: Material, mirror: float) -> Material:
        return replace(material, specular=0.9, shininess=120.0, mirror=mirror)

    solids = [
        place.wall(-1.1, PLASTER),
        place.floor(1.02, 2.2, -1.1, replace(WOOD, mirror=0.12)),
        sphere(place.at(-0.25, 0.12, 0.7), place.meters(0.17, 0.7), material=glossy(BLUE, 0.2)),
        sphere(place.at(0.1, -0.06, 0.1), place.meters(0.14, 0.1), material=glossy(RED, 0.3)),
        sphere(place.at(0.1, 0.3, 1.6), place.meters(0.08, 1.6), material=glossy(MARBLE, 0.55)),
        box(
            (0.95, 0.45, 4.1),
            (0.6, 0.9, 0.6),
            axes=rotation(yaw=30.0),
            material=glossy(CHECKS, 0.15),
        ),
        place.rod((-0.4, -0.4, 0.6), (0.44, -0.26, 0.2), 0.03, glossy(OCHRE, 0.3)),
    ]
    return _Recipe(solids, (-1.3, 2.3))


def _crossing() -> _Recipe:
    fence = replace(SAND, tint=0.0)
    solids = [
        place.wall(-1.13, replace(BRICK, pattern="none")),
        place.card(0.0, 0.0, 0.87, (0.9, 0.5), fence, cutout="slats", cutout_size=0.24),
    ]
    return _Recipe(solids, (-1.3, 1.1), shadow=0.0)


def _still_life() -> _Recipe:
    top = 1.1  # height of the table, below the camera
    table = place.floor(top, 1.6, -1.35, replace(WOOD, mirror=0.04))
    ball = sphere(
        (-0.8, top - 0.68, 3.85), 0.26, material=replace(BLUE, specular=0.35, mirror=0.06)
    )
    books = [
        box((-0.8, top - 0.08, 3.8), (0.95, 0.16, 0.66), axes=rotation(yaw=14.0), material=RED),
        box((-0.82, top - 0.22, 3.82), (0.86, 0.12, 0.6), axes=rotation(yaw=4.0), material=STRIPES),
        box((-0.79, top - 0.35, 3.82), (0.76, 0.14, 0.54), axes=rotation(yaw=20.0), material=OCHRE),
    ]
    screen = plane(
        (-0.25, top - 0.95, 4.8),
        (1.25, 1.9),
        axes=rotation(yaw=-12.0),
        material=MARBLE,
        cutout="holes",
        cutout_size=0.19,
    )
    chest = box(
        (0.86, top - 0.42, 4.45), (0.66, 0.84, 0.66), axes=rotation(yaw=35.0), material=CHECKS
    )
    moss = sphere((0.86, top - 1.13, 4.45), 0.29, material=MOSS)
    plain = Material(dark=(0.86, 0.84, 0.8), light=(0.86, 0.84, 0.8), contrast=0.0, specular=0.3)
    vase = [
        sphere((0.16, top - 0.2, 3.7), 0.2, material=plain, object_id=10),
        bar((0.16, top - 0.36, 3.7), (0.16, top - 0.5, 3.7), 0.08, material=plain, object_id=10),
    ]
    twigs = [
        (-0.1, 1.3, 3.62, 0.011),
        (0.1, 1.5, 3.78, 0.009),
        (0.3, 1.35, 3.66, 0.012),
        (0.5, 1.05, 3.74, 0.008),
        (-0.3, 0.95, 3.76, 0.008),
    ]
    bark = Material(dark=(0.2, 0.13, 0.08), light=(0.5, 0.38, 0.26), grain=0.05)
    bunch = []
    for x, height, z, radius in twigs:
        tip = (x, top - height, z)
        bunch.append(bar((0.16, top - 0.45, 3.7), tip, radius, material=bark))
        bunch.append(sphere(tip, 0.045, material=replace(RED, specular=0.2, grain=0.08)))
    stick = bar((1.12, top, 3.62), (0.62, -1.1, 3.8), 0.014, material=SAND)
    wall = place.wall(-1.35, BRICK)
    solids = [wall, table, *books, ball, screen, chest, moss, *vase, *bunch, stick]
    return _Recipe(solids, (-1.5, 1.7))


_RECIPES: dict[str, Callable[[], _Recipe]] = {
    "demo": _still_life,
    "slanted": _slanted,
    "edges": _edges,
    "thin": _thin,
    "textureless": _textureless,
    "wide": _wide,
    "noisy": _noisy,
    "specular": _specular,
    "crossing": _crossing,
}


def scene_names() -> tuple[str, ...]:
    """The names that `scene` knows.

    Returns:
        Names, the all-round `demo` first.
    """
    return tuple(_RECIPES)


def scene(name: str, *, dtype: Any = jnp.float32, key: PRNGKeyArray | None = None) -> Scene:
    """A scene by its name.

    | name | what it stresses |
    |---|---|
    | `demo` | a still life: a little of everything |
    | `slanted` | slanted, strongly foreshortened surfaces |
    | `edges` | depth edges over a textured background |
    | `thin` | bars down to 1.5 px of 512, screens with holes, foliage |
    | `textureless` | plain surfaces: only outlines and shading |
    | `wide` | disparities from -3.5 to 3.5 px per view step |
    | `noisy` | the still life with sensor noise and blur |
    | `specular` | highlights and reflections that move with the view |
    | `crossing` | two planes; a fence whose EPI lines cross those behind it |

    Disparities are in px per view step at any resolution.

    Args:
        name: one of `scene_names()`.
        dtype: floating dtype of the arrays and of what is rendered.
        key: draws another set of textures; without it the scene is always the same.

    Returns:
        A scene for `render`.

    Raises:
        ValueError: if there is no scene of this name.

    Example:
        >>> scene("wide").disparity_range.round(1).tolist()
        [-3.6, 3.6]
    """
    if name not in _RECIPES:
        raise ValueError(f"`name` must be one of {', '.join(_RECIPES)}, got {name!r}.")
    recipe = _RECIPES[name]()
    seed = 0 if key is None else int(jax.random.randint(key, (), 1, 2000))
    world = make_world(
        recipe.solids,
        lamp=recipe.lamp,
        shadow=recipe.shadow,
        softness=recipe.softness,
        seed=seed,
        dtype=jnp.dtype(dtype),
    )
    return make_scene(
        world,
        disparity_range=recipe.disparity_range,
        blur=recipe.blur,
        read_noise=recipe.read_noise,
        shot_noise=recipe.shot_noise,
        name=name,
    )
