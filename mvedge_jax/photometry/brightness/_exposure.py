"""Brightness of the views: exposure of the whole light field, gain and vignette of each view."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._root import root
from mvedge_jax.lightfield import LightField

from ._vignette import cropped, falloff


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

    def within(
        self, top: int, left: int, size: tuple[int, int], whole: tuple[int, int]
    ) -> "Exposure":
        """The same for a part of every view: its vignettes over the frame of that part.

        Args:
            top: first row of the part.
            left: first column of the part.
            size: rows and columns of the part.
            whole: rows and columns of the views.

        Returns:
            Exactly what multiplies that part of the views. Differentiable.
        """
        if self.vignette is None:
            return self
        return self._replace(vignette=cropped(self.vignette, (top, left), size, whole))

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
