"""Scenes without end: drawn from a key, split into those to learn from and those to judge by."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from mvedge_jax.lightfield import LightField

from ._furniture import Dice, background, thing
from ._make import BLOCK, make_scene, make_world
from ._placing import depth
from ._render import check_grid, render
from .world import FOCUS, GAIN, Scene, Solid, Triple

Split = Literal["train", "validation", "test"]
_SPLITS = get_args(Split)
# Share of the disparity range that scenes leave free at either end.
_MARGIN = (0.01, 0.06)
# Bytes of rendered views that a sequence keeps.
_KEPT = 4 << 30


def random_scene(
    *,
    split: Split = "train",
    disparity_range: tuple[float, float] | None = None,
    dtype: Any = jnp.float32,
    key: PRNGKeyArray,
) -> Scene:
    """A scene like no other: a room, clutter, thin things, holes, light and a sensor, at random.

    Backgrounds are walls, floors, side walls, ceilings and slanted planes; objects are balls, piles
    of boxes, cards, screens with holes, bars and plants. Surfaces reach from plain paint to fine
    texture; some are glossy or mirror the surroundings. There are one to three lamps. Sensors have
    8 or 10 bits, noise and blur, and some have vignettes and gains of their own in every view. All
    scenes share one compiled renderer per size of the views.

    Args:
        split: scenes of one key are unrelated between splits.
        disparity_range: lowest and highest disparity, px per view step. By default it is drawn:
            half its width between .5 and 5 px, its middle near 0.
        dtype: floating dtype of the arrays and of what is rendered.
        key: of everything that is drawn.

    Returns:
        A scene for `render`. All that its views show lies within its range.

    Raises:
        ValueError: there is no such split, or the range is empty or not finite.

    Example:
        >>> import jax
        >>> scene = random_scene(key=jax.random.key(3), disparity_range=(-1.0, 1.0))
        >>> scene.disparity_range.tolist()
        [-1.0, 1.0]
    """
    _check_choice(split, disparity_range)
    folded = jax.random.fold_in(key, _SPLITS.index(split))
    dice = Dice(np.random.default_rng(np.asarray(jax.random.key_data(folded)).tolist()))
    low, high = _drawn_range(dice) if disparity_range is None else disparity_range
    near, far, rig = _rig(dice, low, high)
    solids, room = background(dice, far, near)
    wished = len(solids) + 3 + dice.index(BLOCK - len(solids) - 3)
    while len(solids) < wished:
        solids += thing(dice, room)
    # The wall fills the range's far end; everything else is shortened until it fits.
    fitted = [solids[0], *(_fitted(solid, depth(near), depth(far)) for solid in solids[1:])]
    world = make_world(fitted[:BLOCK], seed=1 + dice.index(1 << 18), dtype=dtype, **_light(dice))
    options = {"read_noise": dice.log(5e-4, 0.015), "shot_noise": dice.log(1e-6, 6e-4)}
    blur = dice.even(0.2, 0.8) if dice.chance(0.5) else 0.0
    scene = make_scene(
        world, disparity_range=(low, high), blur=blur, name="random", **rig, **options
    )
    levels = jnp.asarray(1023.0 if dice.chance(0.3) else 255.0, dtype)
    scene = dataclasses.replace(scene, sensor=dataclasses.replace(scene.sensor, levels=levels))
    if dice.chance(0.25):
        lenses = {"vignette": dice.even(0.05, 0.5), "gain": dice.even(0.0, 0.03)}
        scene = scene.through_lenses(**lenses, vignette_shift=dice.even(0.0, 0.06))
    return scene


def random_light_fields(
    *,
    shape: tuple[int, int, int, int],
    split: Split = "train",
    count: int,
    disparity_range: tuple[float, float] = (-2.0, 2.0),
    zoom: tuple[float, float] = (1.0, 1.0),
    views: Literal["all", "crosshair"] = "all",
    samples: int = 2,
    key: PRNGKeyArray,
) -> Sequence[LightField]:
    """Light fields of random scenes of one shape and range, rendered when they are first read.

    Args:
        shape: view rows, view columns (both odd), height and width in px.
        split: see `random_scene`.
        count: of scenes.
        disparity_range: of all scenes, so that one program serves them.
        zoom: least and largest factor by which views show less than the scene, somewhere within it,
            see `Scene.zoomed`: small views that look like crops of larger ones.
        views: see `render`.
        samples: see `render`.
        key: of all scenes; scene `i` is that of the `i`-th key folded from it.

    Returns:
        A sequence; what was rendered is kept, up to 4 GiB, and rendered again beyond.

    Raises:
        ValueError: `count` is below 1, or `zoom` no range of factors; or as `render` and
            `random_scene` do.
    """
    if count < 1:
        raise ValueError(f"`count` must be at least 1, got {count}.")
    check_grid(shape, samples)
    _check_choice(split, disparity_range)
    if not 1 <= zoom[0] <= zoom[1] < float("inf"):
        raise ValueError(f"`zoom` must be a range of factors of at least 1, got {zoom}.")
    return _Rendered(key, split, count, disparity_range, zoom, shape, views, samples)


class _Rendered(Sequence[LightField]):
    """Renders on demand."""

    def __init__(self, key: PRNGKeyArray, split: Split, count: int, *options: Any):
        self._key, self._count = key, count
        self._split: Split = split
        self._range, self._zoom, self._shape, self._views, self._samples = options
        self._known: dict[int, LightField] = {}
        self._room = _KEPT

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._count))]
        place = range(self._count)[index]
        if place in self._known:
            return self._known[place]
        own = jax.random.fold_in(self._key, place)
        scene = random_scene(split=self._split, disparity_range=self._range, key=own)
        draws = jax.random.uniform(jax.random.fold_in(own, 0), (3,)).tolist()
        factor = self._zoom[0] * (self._zoom[1] / self._zoom[0]) ** draws[0]
        scene = scene.zoomed(factor, (2 * draws[1] - 1, 2 * draws[2] - 1))
        field = render(scene, shape=self._shape, views=self._views, samples=self._samples, key=own)
        field = field.renamed(f"{self._split} scene {place}")
        self._room -= field.views.nbytes
        if self._room >= 0:
            self._known[place] = field
        return field


def _check_choice(split: str, limits: tuple[float, float] | None) -> None:
    if split not in _SPLITS:
        raise ValueError(f"`split` must be one of {_SPLITS}, got {split!r}.")
    if limits is not None and not (np.isfinite(limits).all() and limits[0] < limits[1]):
        raise ValueError(
            f"`disparity_range` must be (low, high), finite with low < high, got {limits}."
        )


def _drawn_range(dice: Dice) -> tuple[float, float]:
    half = dice.log(0.5, 5.0)
    middle = dice.even(-0.2, 0.2) * half
    return middle - half, middle + half


def _rig(dice: Dice, low: float, high: float) -> tuple[float, float, dict[str, float]]:
    """Nearest and farthest disparity as `_placing` has them, and the cameras that see the range.

    Disparities of any two rigs at one place are affine functions of each other.
    """
    width = high - low
    last, first = high - dice.even(*_MARGIN) * width, low + dice.even(*_MARGIN) * width
    most = 3.5 if first <= 0 else min(3.5, 0.5 * (1 + last / first))
    front = dice.even(2.2, 3.4)
    back = front * (1 + dice.even(0.3, 1.0) * (most - 1))
    gain = (last - first) / (1 / front - 1 / back)
    rig = {"gain": gain, "focus": 1 / (1 / back - first / gain)}
    return GAIN * (1 / front - 1 / FOCUS), GAIN * (1 / back - 1 / FOCUS), rig


def _fitted(solid: Solid, front: float, back: float) -> Solid:
    """A solid between two depths, shrunk around its center if it reaches beyond them."""
    depths = [abs(axis[2]) for axis in solid.axes]
    if solid.round:
        reach = solid.half[0] + depths[2] * solid.half[2]
    else:
        reach = sum(d * h for d, h in zip(depths, solid.half, strict=True))
    middle = solid.center[2]
    room = 0.999 * min(middle - front, back - middle)
    if reach <= room:
        return solid
    x, y, z = (max(room, 1e-3) / reach * half for half in solid.half)
    return dataclasses.replace(solid, half=(x, y, z))


def _light(dice: Dice) -> dict[str, Any]:
    """One lamp with a shadow as a rule, up to two without, and light from above and below."""

    def towards() -> Triple:
        return dice.even(-1.0, 1.0), -dice.even(0.1, 1.2), -dice.even(0.2, 1.2)

    def tinted(strength: float, warmth: float) -> Triple:
        return strength * (1 + warmth), strength, strength * (1 - warmth)

    sky = dice.even(0.3, 0.8)
    fills = [(towards(), tinted(dice.even(0.1, 0.5), dice.even(-0.2, 0.2))) for _ in range(2)]
    dark = ((0.0, -1.0, 0.0), (0.0, 0.0, 0.0))
    lit = dice.index(3)
    return {
        "lamp": towards(),
        "lamp_color": tinted(1.0, dice.even(-0.1, 0.2)),
        "lamp_strength": dice.even(0.4, 1.5),
        "sky": tinted(sky, dice.even(-0.15, 0.1)),
        "ground": tinted(sky * dice.even(0.4, 0.9), dice.even(0.0, 0.15)),
        "softness": dice.log(0.01, 0.15),
        "shadow": dice.even(0.5, 1.0) if dice.chance(0.75) else 0.0,
        "fills": [*fills[:lit], *[dark] * (2 - lit)],
    }
