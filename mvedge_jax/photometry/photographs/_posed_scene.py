"""What is found out about posed photographs before anything is measured in them."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._cpu import staged
from mvedge_jax.color import srgb_to_lab

from .._places import Projection
from .._scene import measuring_in
from ..brightness._brightness import Brightness
from ..brightness._denoise import denoised, passed, soften
from ..brightness._gains import gains_along, rough_gains
from ..brightness._noise import Noise, measure_noise
from ..matching._cost import Matching
from ..measuring._grid import PosedGrid, look_around, posed_grid
from ..measuring._look import Look
from ..measuring._measuring import Measurement, Measuring
from ._posed_cost import posed_hypotheses, posed_variance


class PosedScene(NamedTuple):
    """Photographs whose brightness and noise are known.

    Attributes:
        images: the reference first, brightened and gains taken out, `[s, c, y, x]`.
        places: where each of them shows the reference's pixels.
        available: those that are to be read.
        scale: what they were brightened by.
        gain: brightness of each relative to the reference, taken out.
        noise: in their units now.
        guide: the reference, denoised, `[c, y, x]`.
        lab: the same in CIELAB.
        first: per pixel of the reference, the disparity at which the others agree best.
        shown: 1 where a photograph shows the scene, 0 where it is transparent; None for everywhere.
    """

    images: Float[Array, "s c y x"]
    places: Projection
    available: Bool[Array, " s"]
    scale: Float[Array, ""]
    gain: Float[Array, " s"]
    noise: Noise
    guide: Float[Array, "c y x"]
    lab: Float[Array, "c y x"]
    first: Float[Array, "y x"]
    shown: Float[Array, "s y x"] | None = None


class PreparedPhotographs(NamedTuple):
    """Photographs made ready for being measured in: `PreparedViews`, for posed ones.

    Attributes:
        grid: all of them.
        params: of the measurement in views of this noise.
    """

    grid: PosedGrid
    params: Measuring

    def look(self, disparity: Float[Array, "y x"]) -> Look:
        """Reads all photographs around a map, see `look_around`."""
        return look_around(self.grid, disparity, self.params, radius=self.params.radius)


def prepare_photographs(
    images: Float[Array, "s y x c"],
    places: Projection,
    available: Bool[Array, " s"],
    disparities: Float[Array, " d"],
    params: Matching,
    *,
    brightness: Brightness,
    window: int,
    shown: Float[Array, "s y x"] | None = None,
) -> PosedScene:
    """Measures gains and noise, and finds the first map: `prepare`, for posed photographs.

    Args:
        images: sRGB, the reference first.
        places: where each of them shows the reference's pixels.
        available: those that are to be read.
        disparities: what to try, increasing, evenly spaced.
        params: of the hypotheses.
        brightness: how gains and noise are found.
        window: half the width of their windows, px.
        shown: 1 where a photograph shows the scene, 0 where it is transparent; None for everywhere.

    Returns:
        The scene. Differentiable in images, places and parameters at the hypotheses chosen.
    """
    scale, gain = rough_gains(images, available, brightness)
    planes = jnp.moveaxis(images, -1, 1)

    def exposed(gain: Array) -> Array:
        return planes * (scale / gain)[:, None, None, None]

    own = exposed(gain)
    between = posed_variance(own, places, available, disparities, shown)
    noise = measure_noise(own[0], scale, between=between, params=brightness.noise)
    guide = denoised(own[0], noise, params=brightness.noise)
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(guide, 0, -1)), -1, 0)

    @staged
    def searched(
        own: Array, places: Projection, lab: Array, noise: Noise, params: Matching
    ) -> Float[Array, "y x"]:
        soft = soften(own, noise, jnp.clip(0.4 + 30 * noise.deviation, 0.5, 1.0))
        return posed_hypotheses(
            soft, places, available, lab, disparities, params,
            noise=noise, window=window, shown=shown,
        )  # fmt: skip

    first = searched(own, places, lab, noise, params)
    gain = gains_along(images, places, available, first, brightness)
    images = exposed(gain)
    return PosedScene(images, places, available, scale, gain, noise, guide, lab, first, shown)


def posed_sight(scene: PosedScene, params: Measurement) -> PreparedPhotographs:
    """Low-passes photographs as far as their noise asks: `prepare_views`, for posed ones.

    Args:
        scene: see `prepare_photographs`.
        params: of the measurement in views without noise.

    Returns:
        Photographs and parameters for `look_around` and `labels`. Differentiable.
    """
    sigma = jnp.minimum(30 * scene.noise.deviation, 1)
    soft = soften(scene.images, scene.noise, sigma)
    measuring = measuring_in(scene.noise, scene.scale, *passed(scene.noise, sigma), params)
    grid = posed_grid(soft, scene.places, scene.available, scene.shown)
    return PreparedPhotographs(grid, measuring)
