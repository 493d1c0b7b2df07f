"""Brightness of the views: exposure of the whole light field, gain and vignette of each view."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mvedge_jax._crosshair import Crosshair
from mvedge_jax._params import cast
from mvedge_jax._root import root
from mvedge_jax.lightfield import LightField

from ..views._parallax import GridShift
from ._brightness import Brightness
from ._gains import block_means, brightening, earned, ratios_along, rough_ratios
from ._vignette import SIZE, falloff


class Exposure(NamedTuple):
    """What the views are multiplied by before their colours are compared.

    Attributes:
        scale: factor for all views, which makes dark ones as bright as floors and weights expect,
            from 1 to `Brightness.brightest`.
        gain: brightness of each view relative to the centre view, `[v, u]`, or of each photograph
            relative to the first, `[s]`, by which it is divided; 1 for views that were not asked
            for.
        vignette: how the log of that brightness varies over the frame of the view: coefficients
            `[..., i, j]` of the products of Legendre polynomials of degree `i` down and `j` across
            the frame, each of mean square 1; 0 where the views show no more of it than scenes do;
            None for 0 everywhere. Only ratios to the centre view are seen, so that its own
            vignette shows in nothing but parallax: a pixel that its disparity moves outwards is
            darker there. What all views, the centre view too, lose in proportion to the square of
            the distance from the center of the frame is found along a disparity map, if surfaces
            of different disparities lie side by side, and is part of their coefficients. The rest
            of the centre view's own vignette stays in all views.
    """

    scale: Float[Array, ""]
    gain: Float[Array, "*views"]
    vignette: Float[Array, "*views 4 4"] | None = None

    @property
    def unevenness(self) -> Float[Array, "*views"]:
        """Standard deviation over the frame of the log of each vignette over the centre view's."""
        if self.vignette is None:
            return jnp.zeros_like(self.gain)
        shape = self.gain.shape
        own = self.vignette[tuple(n // 2 for n in shape) if len(shape) == 2 else 0]
        # Of orthonormal polynomials.
        change = self.vignette - jnp.broadcast_to(own, self.vignette.shape)
        return root(jnp.sum(change**2, axis=(-2, -1)))

    @property
    def uneven(self) -> Bool[Array, ""]:
        """Whether any view has a vignette."""
        if self.vignette is None:
            return jnp.asarray(False)
        return jnp.any(self.vignette != 0)

    def factors(self, views: Any, shape: tuple[int, ...]) -> Float[Array, "*s y x"]:
        """What pixels are multiplied by to take exposure, gain and vignette out.

        Args:
            views: index of an axis of the grid, or of both.
            shape: rows and columns of the views.

        Returns:
            Of every view and pixel, or of every view, `[..., 1, 1]`, if there is no vignette.
        """
        factor = (self.scale / self.gain[views])[..., None, None]
        return factor if self.vignette is None else factor * falloff(self.vignette[views], shape)

    def everywhere(
        self,
        light_field: LightField,
        disparity: Float[Array, "y x"],
        *,
        params: Brightness | None = None,
    ) -> "Exposure":
        """The same with the gains of all views, measured along a map of the centre view.

        Args:
            light_field: the views as they came.
            disparity: px per view step, `[y, x]`.
            params: see `Brightness`; None for the defaults.

        Returns:
            Gains to about 0.2 %, vignettes where these views have some. Differentiable in the views
            and the map.
        """
        return exposure_along(
            light_field, self.scale, disparity, every=True, params=params, uneven=self.uneven
        )


def expose(light_field: LightField, exposure: Exposure) -> LightField:
    """Takes exposure and gains out of the views.

    Args:
        light_field: the views as they came.
        exposure: what to take out.

    Returns:
        The same with views whose colours compare; bright pixels may exceed 1. Differentiable.

    Example:
        >>> import jax.numpy as jnp
        >>> dark = LightField(jnp.full((3, 3, 8, 8, 3), 0.1))
        >>> exposed = expose(dark, Exposure(jnp.asarray(5.0), jnp.ones((3, 3))))
        >>> bool(jnp.allclose(exposed.views, 0.5))
        True
    """
    factor = exposure.factors(..., light_field.views.shape[2:4])[..., None]
    return eqx.tree_at(lambda field: field.views, light_field, light_field.views * factor)


def exposed_arms(arms: Crosshair, exposure: Exposure) -> Crosshair:
    """`expose` for the crosshair alone.

    Args:
        arms: horizontal and vertical, as they came.
        exposure: what to take out.

    Returns:
        The same, whose colours compare. Differentiable.
    """
    horizontal, vertical = arms
    shape = horizontal.planes.shape[2:]
    across = exposure.factors(vertical.centre, shape)[:, None]
    down = exposure.factors((slice(None), horizontal.centre), shape).swapaxes(-1, -2)[:, None]
    return Crosshair(
        horizontal._replace(planes=horizontal.planes * across),
        vertical._replace(planes=vertical.planes * down),
    )


def rough_exposure(light_field: LightField, *, params: Brightness | None = None) -> Exposure:
    """Exposure, gains and vignettes without knowing any disparity.

    The gain is the median ratio of the blurred views: what parallax adds to it goes both ways.
    Vignettes are fitted to the ratios of means over some 16x16 cells, see `Exposure.vignette`.

    Args:
        light_field: the crosshair of views is read.
        params: see `Brightness`; None for the defaults.

    Returns:
        Gains and vignettes to about 1 %. Differentiable in the views.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> image = jax.random.uniform(jax.random.key(0), (64, 64, 3), minval=0.2, maxval=0.6)
        >>> gain = jnp.asarray([[1.0, 1.1, 1.0], [0.9, 1.0, 1.0], [1.0, 1.0, 1.2]])
        >>> views = gain[:, :, None, None, None] * image[None, None]
        >>> found = rough_exposure(LightField(views)).gain
        >>> [round(float(found[v, u]), 2) for v, u in ((0, 1), (1, 0))]
        [1.1, 0.9]
    """
    views = light_field.views
    params = cast(Brightness() if params is None else params, views.dtype)
    scale = brightening(light_field.centre_view, params)
    vc, uc = light_field.centre
    arms = light_field.horizontal_arm, light_field.vertical_arm
    means = jnp.concatenate([block_means(arm) for arm in arms])
    there = jnp.concatenate([light_field.available[vc], light_field.available[:, uc]])
    found = rough_ratios(means, there, uc, views.shape[2:4], params)

    def crosshair(values: Array, rest: Array) -> Array:
        row, column = jnp.split(values, [views.shape[1]])
        return rest.at[vc].set(row).at[:, uc].set(column)

    grid = views.shape[:2]
    gain = crosshair(earned(found, params), jnp.ones(grid, views.dtype))
    vignette = crosshair(found.vignette, jnp.zeros((*grid, SIZE, SIZE), views.dtype))
    return Exposure(scale, gain, vignette)


def exposure_along(
    light_field: LightField,
    scale: Float[Array, ""],
    disparity: Float[Array, "y x"],
    *,
    every: bool = False,
    params: Brightness | None = None,
    uneven: Bool[Array, ""] | bool = True,
) -> Exposure:
    """Gains and vignettes by robust regression on the centre view, along a disparity map.

    Of the blurred views, every sixteenth pixel either way takes part: blurring keeps noise
    from shrinking the gains, and what the map or an occlusion gets wrong is an outlier.

    Args:
        light_field: the views as they came.
        scale: see `Exposure`.
        disparity: px per view step, `[y, x]`.
        every: measure all views, not those of the crosshair alone.
        params: see `Brightness`; None for the defaults.
        uneven: whether there may be vignettes: what a map gets wrong could pass for some.

    Returns:
        Gains to about 0.2 %, vignettes likewise. Differentiable in the views and the map.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> image = jax.random.uniform(jax.random.key(0), (64, 64, 3), minval=0.2, maxval=0.6)
        >>> gain = jnp.asarray([[1.0, 1.1, 1.0], [0.9, 1.0, 1.0], [1.0, 1.0, 1.2]])
        >>> views = gain[:, :, None, None, None] * image[None, None]
        >>> found = exposure_along(LightField(views), jnp.ones(()), jnp.zeros((64, 64))).gain
        >>> [round(float(found[v, u]), 3) for v, u in ((0, 1), (1, 0))]
        [1.1, 0.9]
    """
    views, (rows, columns) = light_field.views, light_field.views.shape[:2]
    params = cast(Brightness() if params is None else params, views.dtype)
    own = light_field.centre
    places = [
        (v, u) for v in range(rows) for u in range(columns) if every or v == own[0] or u == own[1]
    ]
    v, u = (np.asarray(axis) for axis in zip(*places, strict=True))
    found = ratios_along(
        views[v, u],
        GridShift(light_field.steps[v, u].astype(views.dtype)),
        light_field.available[v, u],
        places.index(own),
        disparity,
        params,
        uneven=uneven,
    )
    gain = jnp.ones((rows, columns), views.dtype).at[v, u].set(earned(found, params))
    # Views that were not asked for have what all have in common.
    centre = found.vignette[places.index(own)][None, None]
    vignette = jnp.broadcast_to(centre, (rows, columns, SIZE, SIZE)).at[v, u].set(found.vignette)
    return Exposure(scale, gain, vignette)
