"""What a synthetic scene is made of: solids with materials, a light, a camera rig, a sensor."""

import dataclasses
from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.lightfield import Camera

Triple = tuple[float, float, float]
Pattern = Literal["none", "checks", "bricks", "stripes", "dots"]
Cutout = Literal["none", "holes", "slats", "leaves"]

FOCAL, GAIN, FOCUS = 1.4, 20.0, 4.0  # of a rig, unless it says otherwise


@dataclass(frozen=True)
class Material:
    """How a surface looks; colors are sRGB in [0, 1].

    The base color runs from `dark` to `light` with fractal noise in the solid's own coordinates;
    a pattern in the color `accent` is laid over it.

    Attributes:
        dark: color where the noise is low.
        light: color where the noise is high; the same as `dark` for a plain surface.
        contrast: amplitude of the noise, 0 for none; 1 about fills the range of the two colors.
        grain: size of the coarsest noise cells, meters.
        gain: amplitude of each octave relative to the next coarser one, in (0, 1).
        stretch: how much longer the noise is along the solid's axes (wood, brushed metal).
        pattern: what is laid over the noise.
        accent: color of the pattern.
        size: period of the pattern along the surface, meters.
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
        center: where it is, meters, in the center camera's frame (x right, y down, z forward).
        axes: its three orthonormal axes in that frame, as rows.
        half: half its extent along each axis; radius and half length if `round`.
        round: a sphere or a bar with round ends along its third axis, otherwise a box.
        material: its surface.
        cutout: holes through it; for a plane.
        cutout_size: period of the holes, meters.
        object_id: what the ground truth calls it, 1 or more; 0 numbers it by its place in the list.
    """

    center: Triple
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
        center: meters.
        axes: rows, orthonormal.
        half: half extents, meters.
        round: spheres and bars.
        cutout: which pattern of holes, 0 for none.
        cutout_size: period of the holes, meters.
        object_id: what the ground truth says.
        count: how many are there; the rest is padding.
    """

    center: Float[Array, "n 3"]
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
        table: one column per solid, with all that shading looks up at once: center (3), axes (9),
            half (3), round, dark (3), light (3), accent (3), stretch (3), pattern, contrast,
            frequency (1 / grain), gain, size, aspect, tint, specular, shininess, mirror. Colors in
            linear light.
        seed: of the noise.
    """

    table: Float[Array, "k n"]
    seed: Int[Array, ""]


class Light(eqx.Module):
    """A distant lamp and the light of the surroundings.

    Attributes:
        direction: towards the lamp, unit length.
        color: of the lamp, linear.
        sky: light from above, linear.
        ground: light from below, linear.
        softness: half the angle under which the lamp is seen, radians; it blurs shadows.
        shadow: how much of the lamp a solid takes away, 0 for no shadows (and quicker), 1 for all.
        fills: direction (unit length) and color (linear) of further lamps, which cast no shadows.
    """

    direction: Float[Array, "3"]
    color: Float[Array, "3"]
    sky: Float[Array, "3"]
    ground: Float[Array, "3"]
    softness: Float[Array, ""]
    shadow: Float[Array, ""]
    fills: Float[Array, "f 2 3"]


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
        gain: `focal_px * baseline`, px meters.
        focus: distance of zero disparity, meters.
        place: where the center camera is, to the right and down, meters.
    """

    focal: Float[Array, ""]
    gain: Float[Array, ""]
    focus: Float[Array, ""]
    place: Float[Array, "2"]

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
        vignette: share of the sRGB values that is lost in the corners, 0 to 1; what is lost grows
            with the square of the distance from the vignette's center.
        vignette_shift: standard deviation of that center, another in every view, over the shorter
            side of the views.
        gain: standard deviation of the brightness of the views, relative.
        levels: steps between black and white, such as 255 for 8 bits; 0 for no quantization.
    """

    blur: Float[Array, ""]
    read_noise: Float[Array, ""]
    shot_noise: Float[Array, ""]
    vignette: Float[Array, ""]
    vignette_shift: Float[Array, ""]
    gain: Float[Array, ""]
    levels: Float[Array, ""]


class Scene(eqx.Module):
    """A synthetic scene, ready to be rendered at any size.

    Attributes:
        world: what is seen.
        rig: the light-field cameras.
        sensor: blur, noise, vignettes and gains.
        disparity_range: lowest and highest disparity in the scene, px per view step.
        name: what to call it.
    """

    world: World
    rig: Rig
    sensor: Sensor
    disparity_range: Float[Array, "2"]
    name: str = eqx.field(static=True)

    def spaced(self, baseline: float) -> "Scene":
        """The same scene seen by cameras farther apart by a positive factor: all disparities grow.

        Example:
            >>> from mvedge_jax.datasets import synthetic
            >>> synthetic.scene("wide").spaced(1.4).disparity_range.round(2).tolist()
            [-5.04, 5.04]
        """
        if not 0 < baseline < float("inf"):
            raise ValueError(f"`baseline` must be positive and finite, got {baseline}.")
        rig = dataclasses.replace(self.rig, gain=baseline * self.rig.gain)
        return dataclasses.replace(self, rig=rig, disparity_range=baseline * self.disparity_range)

    def zoomed(self, factor: float, towards: tuple[float, float] = (0.0, 0.0)) -> "Scene":
        """A part of the scene as it looks in a larger picture: disparities stay, objects grow.

        Args:
            factor: by which the field of view is narrower, at least 1. Views of 128 px with a
                factor of 4 show textures and outlines as views of 512 px do.
            towards: which part, from (-1, -1), the top left, to (1, 1); nothing is shown that was
                beside the pictures.

        Raises:
            ValueError: `factor` is below 1 or not finite, or `towards` is out of range.
        """
        if not 1 <= factor < float("inf"):
            raise ValueError(f"`factor` must be finite and at least 1, got {factor}.")
        if not all(-1 <= side <= 1 for side in towards):
            raise ValueError(f"`towards` must be two numbers between -1 and 1, got {towards}.")
        rig = self.rig
        # The nearest surface leaves the least room: half of its width that is no longer seen.
        nearest = 1 / (self.disparity_range[1] / rig.gain + 1 / rig.focus)
        room = (1 - 1 / factor) * nearest / (2 * rig.focal)
        place = rig.place + room * jnp.asarray(towards, rig.place.dtype)
        rig = dataclasses.replace(rig, focal=factor * rig.focal, place=place)
        return dataclasses.replace(self, rig=rig)

    def through_lenses(
        self, *, vignette: float = 0.4, vignette_shift: float = 0.05, gain: float = 0.02
    ) -> "Scene":
        """The same scene seen by lenses of uneven brightness, see `Sensor`."""
        given = {"vignette": vignette, "vignette_shift": vignette_shift, "gain": gain}
        for label, value in given.items():
            if not 0 <= value <= 1:
                raise ValueError(f"`{label}` must be between 0 and 1, got {value}.")
        dtype = self.sensor.blur.dtype
        changed = {label: jnp.asarray(value, dtype) for label, value in given.items()}
        return dataclasses.replace(self, sensor=dataclasses.replace(self.sensor, **changed))
