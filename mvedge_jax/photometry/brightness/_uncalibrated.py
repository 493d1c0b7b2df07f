"""Views as they came: what their brightness is measured and taken out by."""

from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._crosshair import Crosshair, crosshair
from mvedge_jax._params import cast
from mvedge_jax.lightfield import LightField

from ..views import ViewSet
from ._brightness import Brightness
from ._exposure import Exposure, exposed_arms, exposure_along, rough_exposure
from ._gains import block_means, brightening, earned, ratios_along, rough_ratios
from ._unlit import lit


@runtime_checkable
class Uncalibrated(Protocol):
    """Views as they came, one of which is the reference."""

    @property
    def reference(self) -> Any:
        """Index of the reference among the views of an `Exposure`."""
        ...

    def rough_exposure(self, params: Brightness) -> Exposure:
        """Exposure without knowing any disparity."""
        ...

    def exposure_along(
        self, scale: Float[Array, ""], disparity: Float[Array, "y x"], params: Brightness
    ) -> Exposure:
        """Exposure of this scale, gains and vignettes measured along a map of the reference."""
        ...

    def exposed(self, exposure: Exposure) -> Crosshair | ViewSet:
        """The views that are compared, exposure taken out."""
        ...

    def lit(self, params: Brightness) -> Float[Array, "y x"] | None:
        """0 where the reference shows nothing of the scene, 1 elsewhere; None for 1 everywhere."""
        ...


class GridViews(eqx.Module):
    """The views of a light field, of which those of the crosshair are compared.

    Attributes:
        light_field: the views.
        arms: its crosshair.
        every: measure the gains of all views along a map, not of the crosshair alone.
    """

    light_field: LightField
    arms: Crosshair
    every: bool = eqx.field(static=True)

    def __init__(self, light_field: LightField, *, every: bool = False):
        self.light_field, self.every = light_field, every
        self.arms = crosshair(light_field)

    @property
    def reference(self) -> tuple[int, int]:
        """See `Uncalibrated`."""
        return self.light_field.centre

    def rough_exposure(self, params: Brightness) -> Exposure:
        """See `Uncalibrated`."""
        return rough_exposure(self.light_field, params=params)

    def exposure_along(
        self, scale: Float[Array, ""], disparity: Float[Array, "y x"], params: Brightness
    ) -> Exposure:
        """See `Uncalibrated`."""
        return exposure_along(self.light_field, scale, disparity, every=self.every, params=params)

    def exposed(self, exposure: Exposure) -> Crosshair:
        """See `Uncalibrated`."""
        return exposed_arms(self.arms, exposure)

    def lit(self, params: Brightness) -> Float[Array, "y x"]:
        """See `Uncalibrated`."""
        return lit(self.arms, params)


class PosedViews(eqx.Module):
    """Posed photographs, all of which are compared.

    Attributes:
        views: the reference first.
    """

    views: ViewSet

    @property
    def reference(self) -> int:
        """See `Uncalibrated`."""
        return 0

    @property
    def _images(self) -> Float[Array, "s y x c"]:
        return jnp.moveaxis(self.views.planes, 1, -1)

    def rough_exposure(self, params: Brightness) -> Exposure:
        """See `Uncalibrated`: no vignettes, for what looks elsewhere shows something else."""
        images, there = self._images, self.views.available
        params = cast(params, images.dtype)
        means, shape = block_means(images), images.shape[1:3]
        found = rough_ratios(means, there, 0, shape, params, uneven=False)
        return Exposure(brightening(images[0], params), earned(found, params), found.vignette)

    def exposure_along(
        self, scale: Float[Array, ""], disparity: Float[Array, "y x"], params: Brightness
    ) -> Exposure:
        """See `Uncalibrated`."""
        params, of = cast(params, disparity.dtype), self.views
        found = ratios_along(
            self._images, of.parallax, of.available, 0, disparity, params, uneven=True
        )
        return Exposure(scale, earned(found, params), found.vignette)

    def exposed(self, exposure: Exposure) -> ViewSet:
        """See `Uncalibrated`."""
        factors = exposure.factors(..., self.views.planes.shape[2:])
        return self.views.mapped(lambda planes: planes * factors[:, None])

    def lit(self, params: Brightness) -> Float[Array, "y x"] | None:
        """See `Uncalibrated`: where the reference is opaque."""
        del params
        return None if self.views.shown is None else self.views.shown[0]
