"""Worlds from solids and a light, scenes from worlds and cameras."""

from collections.abc import Sequence
from typing import Any, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .world import (
    FOCAL,
    FOCUS,
    GAIN,
    Cutout,
    Light,
    Pattern,
    Rig,
    Scene,
    Sensor,
    Solid,
    Solids,
    Surfaces,
    Triple,
    World,
)

_PATTERNS, _CUTOUTS = get_args(Pattern), get_args(Cutout)
BLOCK = 32  # solids are padded to a multiple of it, so that scenes share a compiled function


def _linear(color: Triple) -> np.ndarray:
    srgb = np.asarray(color, float)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _column(solid: Solid) -> np.ndarray:
    """What `Surfaces.table` holds of a solid."""
    m = solid.material
    parts = [
        solid.center,
        np.ravel(solid.axes),
        solid.half,
        [solid.round],
        _linear(m.dark),
        _linear(m.light),
        _linear(m.accent),
        m.stretch,
        [_PATTERNS.index(m.pattern), m.contrast, 1.0 / m.grain, m.gain, m.size, m.aspect, m.tint],
        [m.specular, m.shininess, m.mirror],
    ]
    return np.concatenate([np.asarray(part, float) for part in parts])


def make_world(
    solids: Sequence[Solid],
    *,
    lamp: Triple = (-0.45, -0.8, -0.55),
    lamp_color: Triple = (1.0, 0.93, 0.82),
    lamp_strength: float = 0.9,
    sky: Triple = (0.42, 0.47, 0.55),
    ground: Triple = (0.28, 0.25, 0.22),
    softness: float = 0.03,
    shadow: float = 1.0,
    fills: Sequence[tuple[Triple, Triple]] = (),
    seed: int = 0,
    dtype: Any = jnp.float32,
) -> World:
    """Gathers solids and a light into the arrays that the ray caster reads.

    Args:
        solids: what is there, one at least.
        lamp: direction towards the lamp, any length.
        lamp_color: linear light.
        lamp_strength: what `lamp_color` is multiplied by.
        sky: light from above, linear.
        ground: light from below, linear.
        softness: half the angle under which the lamp is seen, radians.
        shadow: how much of the lamp a solid takes away, in [0, 1]; 0 is quicker.
        fills: further lamps, which cast no shadows: direction, any length, and linear light.
        seed: of the textures.
        dtype: floating dtype of the arrays, hence of the renderings.

    Returns:
        What the ray caster reads; give it cameras with `make_scene`. A ValueError without solids.

    Example:
        >>> from mvedge_jax.datasets import synthetic
        >>> wall = synthetic.plane((0.0, 0.0, 5.0), (9.0, 9.0))
        >>> ball = synthetic.sphere((0.0, 0.0, 4.0), 0.5)
        >>> int(synthetic.make_world([wall, ball]).solids.count)
        2
    """
    if not solids:
        raise ValueError("`solids` must have at least one solid, got none.")
    padding = -len(solids) % BLOCK
    padded = [*solids, *[solids[0]] * padding]

    def floats(values: Any) -> Array:
        return jnp.asarray(np.asarray(values, float), dtype)

    def ints(values: Any) -> Array:
        return jnp.asarray(np.asarray(values), jnp.int32)

    def unit(vector: Triple) -> np.ndarray:
        return np.asarray(vector, float) / np.linalg.norm(vector)

    lamp_rgb = np.asarray(lamp_color, float) * lamp_strength
    return World(
        Solids(
            center=floats([s.center for s in padded]),
            axes=floats([s.axes for s in padded]),
            half=floats([s.half for s in padded]),
            round=jnp.asarray([s.round for s in padded]),
            cutout=ints([_CUTOUTS.index(s.cutout) for s in padded]),
            cutout_size=floats([s.cutout_size for s in padded]),
            object_id=ints([s.object_id or k + 1 for k, s in enumerate(padded)]),
            count=jnp.asarray(len(solids), jnp.int32),
        ),
        Surfaces(floats(np.stack([_column(s) for s in padded], axis=1)), ints(7919 * seed)),
        Light(
            direction=floats(list(unit(lamp))),
            color=floats(list(lamp_rgb)),
            sky=floats(list(sky)),
            ground=floats(list(ground)),
            softness=floats(softness),
            shadow=floats(shadow),
            fills=floats([(unit(towards), light) for towards, light in fills]).reshape(-1, 2, 3),
        ),
    )


def make_scene(
    world: World,
    *,
    disparity_range: tuple[float, float],
    focal: float = FOCAL,
    gain: float = GAIN,
    focus: float = FOCUS,
    blur: float = 0.0,
    read_noise: float = 0.0,
    shot_noise: float = 0.0,
    name: str = "synthetic",
) -> Scene:
    """Puts cameras in front of a world.

    Args:
        world: see `make_world`.
        disparity_range: lowest and highest disparity that a method should look for, px per view
            step.
        focal: focal length over the longer side of the views.
        gain: px meters; a point at depth `z` meters has the disparity `gain (1 / z - 1 / focus)`.
        focus: distance of zero disparity, meters.
        blur: standard deviation of the optics' blur, px, 0 to 3.
        read_noise: standard deviation of the noise in the dark, of sRGB in [0, 1].
        shot_noise: variance that is added per unit of sRGB.
        name: what to call it.

    Returns:
        A scene for `render`.

    Raises:
        ValueError: if a number is out of its range.
    """
    for label, value in (("focal", focal), ("gain", gain), ("focus", focus)):
        if not value > 0:
            raise ValueError(f"`{label}` must be positive, got {value}.")
    for label, value in (("read_noise", read_noise), ("shot_noise", shot_noise)):
        if not value >= 0:
            raise ValueError(f"`{label}` must not be negative, got {value}.")
    if not 0 <= blur <= 3:
        raise ValueError(f"`blur` must be between 0 and 3 px, got {blur}.")
    low, high = disparity_range
    if not low < high:
        raise ValueError(f"`disparity_range` must be (low, high) with low < high, got {low, high}.")
    dtype = world.solids.center.dtype

    def number(value: float) -> Array:
        return jnp.asarray(np.asarray(value, float), dtype)

    return Scene(
        world,
        Rig(number(focal), number(gain), number(focus), jnp.zeros(2, dtype)),
        Sensor(*map(number, (blur, read_noise, shot_noise, 0.0, 0.0, 0.0, 0.0))),
        jnp.asarray(np.asarray([low, high], float), dtype),
        name,
    )
