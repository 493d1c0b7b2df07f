"""What a synthetic scene is made of: solids with materials, a light, a camera rig, a sensor."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.lightfield import Camera

Triple = tuple[float, float, float]
Pattern = Literal["none", "checks", "bricks", "stripes", "dots"]
Cutout = Literal["none", "holes", "slats", "leaves"]

_PATTERNS: tuple[Pattern, ...] = ("none", "checks", "bricks", "stripes", "dots")
_CUTOUTS: tuple[Cutout, ...] = ("none", "holes", "slats", "leaves")
FOCAL, GAIN, FOCUS = 1.4, 20.0, 4.0  # of a rig, unless it says otherwise
_BLOCK = 32  # solids are padded to a multiple of it, so that scenes share a compiled function


@dataclass(frozen=True)
class Material:
    """How a surface looks; colours are sRGB in [0, 1].

    The base colour runs from `dark` to `light` with fractal noise in the solid's own coordinates;
    a pattern in the colour `accent` is laid over it.

    Attributes:
        dark: colour where the noise is low.
        light: colour where the noise is high; the same as `dark` for a plain surface.
        contrast: amplitude of the noise, 0 for none; 1 about fills the range of the two colours.
        grain: size of the coarsest noise cells, metres.
        gain: amplitude of each octave relative to the next coarser one, in (0, 1).
        stretch: how much longer the noise is along the solid's axes (wood, brushed metal).
        pattern: what is laid over the noise.
        accent: colour of the pattern.
        size: period of the pattern along the surface, metres.
        aspect: width over height of a brick.
        tint: random brightness of the pattern's cells, relative.
        specular: strength of the highlight of a light source; depends on the view.
        shininess: exponent of the highlight.
        mirror: part of the surroundings' light that is reflected; depends on the view.
    """

    dark: Triple = (0.30, 0.28, 0.25)
    light: Triple = (0.75, 0.72, 0.66)
    contrast: float = 1.0
    grain: float = 0.4
    gain: float = 0.65
    stretch: Triple = (1.0, 1.0, 1.0)
    pattern: Pattern = "none"
    accent: Triple = (0.15, 0.15, 0.15)
    size: float = 0.2
    aspect: float = 1.0
    tint: float = 0.0
    specular: float = 0.0
    shininess: float = 60.0
    mirror: float = 0.0


@dataclass(frozen=True)
class Solid:
    """One object; made by `plane`, `box`, `sphere` or `bar`.

    Attributes:
        centre: where it is, metres, in the centre camera's frame (x right, y down, z forward).
        axes: its three orthonormal axes in that frame, as rows.
        half: half its extent along each axis; radius and half length if `round`.
        round: a sphere or a bar with round ends along its third axis, otherwise a box.
        material: its surface.
        cutout: holes through it; for a plane.
        cutout_size: period of the holes, metres.
        object_id: what the ground truth calls it, 1 or more; 0 numbers it by its place in the list.
    """

    centre: Triple
    axes: tuple[Triple, Triple, Triple]
    half: Triple
    round: bool = False
    material: Material = field(default_factory=Material)
    cutout: Cutout = "none"
    cutout_size: float = 0.2
    object_id: int = 0


class Solids(eqx.Module):
    """`Solid`s as arrays, padded.

    Attributes:
        centre: metres.
        axes: rows, orthonormal.
        half: half extents, metres.
        round: spheres and bars.
        cutout: which pattern of holes, 0 for none.
        cutout_size: period of the holes, metres.
        object_id: what the ground truth says.
        count: how many are there; the rest is padding.
    """

    centre: Float[Array, "n 3"]
    axes: Float[Array, "n 3 3"]
    half: Float[Array, "n 3"]
    round: Bool[Array, " n"]
    cutout: Int[Array, " n"]
    cutout_size: Float[Array, " n"]
    object_id: Int[Array, " n"]
    count: Int[Array, ""]


class Surfaces(eqx.Module):
    """How the `Solids` look.

    Attributes:
        table: one column per solid, with all that shading looks up at once: centre (3), axes (9),
            half (3), round, dark (3), light (3), accent (3), stretch (3), pattern, contrast,
            frequency (1 / grain), gain, size, aspect, tint, specular, shininess, mirror. Colours in
            linear light.
        seed: of the noise.
    """

    table: Float[Array, "k n"]
    seed: Int[Array, ""]


class Light(eqx.Module):
    """A distant lamp and the light of the surroundings.

    Attributes:
        direction: towards the lamp, unit length.
        colour: of the lamp, linear.
        sky: light from above, linear.
        ground: light from below, linear.
        softness: half the angle under which the lamp is seen, radians; it blurs shadows.
        shadow: how much of the lamp a solid takes away, 0 for no shadows (and quicker), 1 for all.
    """

    direction: Float[Array, "3"]
    colour: Float[Array, "3"]
    sky: Float[Array, "3"]
    ground: Float[Array, "3"]
    softness: Float[Array, ""]
    shadow: Float[Array, ""]


class World(eqx.Module):
    """All that light falls on: what the ray caster reads.

    Attributes:
        solids: geometry.
        surfaces: appearance.
        light: lamp and surroundings.
    """

    solids: Solids
    surfaces: Surfaces
    light: Light


class Rig(eqx.Module):
    """The camera grid, free of resolution: disparities are in px whatever the size of the views.

    The baseline is chosen for the size of the views: `disparity = gain (1 / z - 1 / focus)`.

    Attributes:
        focal: focal length over the longer side of the views.
        gain: `focal_px * baseline`, px metres.
        focus: distance of zero disparity, metres.
    """

    focal: Float[Array, ""]
    gain: Float[Array, ""]
    focus: Float[Array, ""]

    def camera(self, height: int, width: int) -> Camera:
        """The cameras for views of a size in px."""
        focal_px = self.focal * max(height, width)
        return Camera(focal_px, self.gain / focal_px, self.focus)


class Sensor(eqx.Module):
    """What the camera does to the light.

    Attributes:
        blur: standard deviation of the optics' Gaussian blur, px, up to 3; 0 for none.
        read_noise: standard deviation of the noise in the dark, of sRGB in [0, 1].
        shot_noise: variance that is added per unit of sRGB.
    """

    blur: Float[Array, ""]
    read_noise: Float[Array, ""]
    shot_noise: Float[Array, ""]


class Scene(eqx.Module):
    """A synthetic scene, ready to be rendered at any size.

    Attributes:
        world: what is seen.
        rig: the light-field cameras.
        sensor: blur and noise.
        disparity_range: lowest and highest disparity in the scene, px per view step.
        name: what to call it.
    """

    world: World
    rig: Rig
    sensor: Sensor
    disparity_range: Float[Array, "2"]
    name: str = eqx.field(static=True)


def _linear(colour: Triple) -> np.ndarray:
    srgb = np.asarray(colour, float)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _column(solid: Solid) -> np.ndarray:
    """What `Surfaces.table` holds of a solid."""
    m = solid.material
    parts = [
        solid.centre,
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
    lamp_colour: Triple = (1.0, 0.93, 0.82),
    lamp_strength: float = 0.9,
    sky: Triple = (0.42, 0.47, 0.55),
    ground: Triple = (0.28, 0.25, 0.22),
    softness: float = 0.03,
    shadow: float = 1.0,
    seed: int = 0,
    dtype: Any = jnp.float32,
) -> World:
    """Gathers solids and a light into the arrays that the ray caster reads.

    Args:
        solids: what is there, one at least.
        lamp: direction towards the lamp, any length.
        lamp_colour: linear light.
        lamp_strength: what `lamp_colour` is multiplied by.
        sky: light from above, linear.
        ground: light from below, linear.
        softness: half the angle under which the lamp is seen, radians.
        shadow: how much of the lamp a solid takes away, in [0, 1]; 0 is quicker.
        seed: of the textures.
        dtype: floating dtype of the arrays, hence of the renderings.

    Returns:
        What the ray caster reads; give it cameras with `make_scene`.

    Raises:
        ValueError: without solids.

    Example:
        >>> from mvedge_jax.datasets import synthetic
        >>> wall = synthetic.plane((0.0, 0.0, 5.0), (9.0, 9.0))
        >>> ball = synthetic.sphere((0.0, 0.0, 4.0), 0.5)
        >>> int(synthetic.make_world([wall, ball]).solids.count)
        2
    """
    if not solids:
        raise ValueError("`solids` must have at least one solid, got none.")
    padding = -len(solids) % _BLOCK
    padded = [*solids, *[solids[0]] * padding]

    def floats(values: Any) -> Array:
        return jnp.asarray(np.asarray(values, float), dtype)

    def ints(values: Any) -> Array:
        return jnp.asarray(np.asarray(values), jnp.int32)

    def unit(vector: Triple) -> np.ndarray:
        return np.asarray(vector, float) / np.linalg.norm(vector)

    lamp_rgb = np.asarray(lamp_colour, float) * lamp_strength
    return World(
        Solids(
            centre=floats([s.centre for s in padded]),
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
            colour=floats(list(lamp_rgb)),
            sky=floats(list(sky)),
            ground=floats(list(ground)),
            softness=floats(softness),
            shadow=floats(shadow),
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
        gain: px metres; a point at depth `z` metres has the disparity `gain (1 / z - 1 / focus)`.
        focus: distance of zero disparity, metres.
        blur: standard deviation of the optics' blur, px, 0 to 3.
        read_noise: standard deviation of the noise in the dark, of sRGB in [0, 1].
        shot_noise: variance that is added per unit of sRGB.
        name: what to call it.

    Returns:
        A scene for `render` and `render_posed`.

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
    dtype = world.solids.centre.dtype

    def number(value: float) -> Array:
        return jnp.asarray(np.asarray(value, float), dtype)

    return Scene(
        world,
        Rig(number(focal), number(gain), number(focus)),
        Sensor(number(blur), number(read_noise), number(shot_noise)),
        jnp.asarray(np.asarray([low, high], float), dtype),
        name,
    )
