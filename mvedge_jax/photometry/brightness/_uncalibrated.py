"""Raw views, with the measurement and removal of their brightness."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax._crosshair import Crosshair, crosshair
from mvedge_jax._params import cast
from mvedge_jax.lightfield import LightField

from ..views import GridShift, ViewSet
from ._brightness import Brightness
from ._exposure import Exposure
from ._gains import block_means, brightening, ratios_along, rough_ratios, shrunk_gains
from ._unlit import lit
from ._vignette import SIZE


class GridViews(eqx.Module):
    """The views of a light field; those of the crosshair are compared.

    Attributes:
        light_field: the views.
        arms: the crosshair of the light field.
        every: measure the gains of all views along a map instead of the crosshair alone.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> image = jax.random.uniform(jax.random.key(0), (64, 64, 3), minval=0.2, maxval=0.6)
        >>> gain = jnp.asarray([[1.0, 1.1, 1.0], [0.9, 1.0, 1.0], [1.0, 1.0, 1.2]])
        >>> views = GridViews(LightField(gain[:, :, None, None, None] * image[None, None]))
        >>> gain = views.exposure_along(jnp.ones(()), jnp.zeros((64, 64)), Brightness()).gain
        >>> [round(float(gain[v, u]), 3) for v, u in ((0, 1), (1, 0))]
        [1.1, 0.9]
    """

    light_field: LightField
    arms: Crosshair
    every: bool = eqx.field(static=True)

    def __init__(self, light_field: LightField, *, every: bool = False):
        self.light_field, self.every = light_field, every
        self.arms = crosshair(light_field)

    @property
    def reference(self) -> tuple[int, int]:
        """Index of the reference among the views of an `Exposure`."""
        return self.light_field.center

    def rough_exposure(self, params: Brightness) -> Exposure:
        """Exposure, gains and vignettes without known disparities, to about 1 %. Differentiable.

        The gain is the median ratio of the blurred views, in which the effect of parallax cancels.
        Vignettes are fitted to ratios of means over some 16x16 cells.
        """
        of, views = self.light_field, self.light_field.views
        params, (vc, uc) = cast(params, views.dtype), of.center
        means = jnp.concatenate([block_means(arm) for arm in (of.horizontal_arm, of.vertical_arm)])
        there = jnp.concatenate([of.available[vc], of.available[:, uc]])
        ratios = rough_ratios(means, there, uc, views.shape[2:4], params)

        def placed(values: Array, rest: Array) -> Array:
            row, column = jnp.split(values, [views.shape[1]])
            return rest.at[vc].set(row).at[:, uc].set(column)

        gain = placed(shrunk_gains(ratios, params), jnp.ones(views.shape[:2], views.dtype))
        even = jnp.zeros((*views.shape[:2], SIZE, SIZE), views.dtype)
        scale = brightening(of.center_view, params)
        return Exposure(scale, gain, placed(ratios.vignette, even))

    def exposure_along(
        self,
        scale: Float[Array, ""],
        disparity: Float[Array, "y x"],
        params: Brightness,
        *,
        uneven: Bool[Array, ""] | bool = True,
    ) -> Exposure:
        """Gains and vignettes by robust regression on the reference, along its disparity map.

        The accuracy is about 0.2 %. Every sixteenth pixel of the blurred views along either axis is
        used: the blur avoids the bias of gains by noise, and errors of the map and occlusions are
        outliers. No vignettes unless `uneven`: map errors can look like them. Differentiable.
        """
        of, views, own = self.light_field, self.light_field.views, self.reference
        params, grid = cast(params, views.dtype), views.shape[:2]
        asked = [at for at in np.ndindex(grid) if self.every or at[0] == own[0] or at[1] == own[1]]
        v, u = (np.asarray(axis) for axis in zip(*asked, strict=True))
        shifts, there = GridShift(of.steps[v, u].astype(views.dtype)), of.available[v, u]
        ratios = ratios_along(
            views[v, u], shifts, there, asked.index(own), disparity, params, uneven=uneven
        )
        gain = jnp.ones(grid, views.dtype).at[v, u].set(shrunk_gains(ratios, params))
        # Views that were not measured get the common part.
        vignette = jnp.broadcast_to(ratios.vignette[asked.index(own)], (*grid, SIZE, SIZE))
        return Exposure(scale, gain, vignette.at[v, u].set(ratios.vignette))

    def exposed(self, exposure: Exposure) -> Crosshair:
        """The views to compare, after exposure."""
        across, down = self.arms
        shape = across.planes.shape[2:]
        rows = exposure.factors(down.center, shape)[:, None]
        columns = exposure.factors((slice(None), across.center), shape).swapaxes(-1, -2)[:, None]
        return Crosshair(
            across._replace(planes=across.planes * rows),
            down._replace(planes=down.planes * columns),
        )

    def lit(self, params: Brightness) -> Float[Array, "y x"]:
        """0 in and around the vignette mask of the reference, 1 elsewhere."""
        return lit(self.arms, params)


class PosedViews(eqx.Module):
    """Posed photographs, all of which are compared.

    Attributes:
        views: the photographs, the reference first.
    """

    views: ViewSet

    @property
    def reference(self) -> int:
        """See `GridViews`."""
        return 0

    @property
    def _images(self) -> Float[Array, "s y x c"]:
        return jnp.moveaxis(self.views.planes, 1, -1)

    def rough_exposure(self, params: Brightness) -> Exposure:
        """See `GridViews`; no vignettes, as photographs differ in what they show."""
        images, there = self._images, self.views.available
        params, shape = cast(params, images.dtype), images.shape[1:3]
        ratios = rough_ratios(block_means(images), there, 0, shape, params, uneven=False)
        return Exposure(
            brightening(images[0], params), shrunk_gains(ratios, params), ratios.vignette
        )

    def exposure_along(
        self, scale: Float[Array, ""], disparity: Float[Array, "y x"], params: Brightness
    ) -> Exposure:
        """See `GridViews`."""
        params, of = cast(params, disparity.dtype), self.views
        ratios = ratios_along(
            self._images, of.parallax, of.available, 0, disparity, params, uneven=True
        )
        return Exposure(scale, shrunk_gains(ratios, params), ratios.vignette)

    def exposed(self, exposure: Exposure) -> ViewSet:
        """See `GridViews`."""
        factors = exposure.factors(..., self.views.planes.shape[2:])
        return self.views.mapped(lambda planes: planes * factors[:, None])

    def lit(self, params: Brightness) -> Float[Array, "y x"] | None:
        """1 where the reference is opaque, 0 elsewhere; None for 1 everywhere."""
        del params
        return None if self.views.shown is None else self.views.shown[0]


Uncalibrated = GridViews | PosedViews
