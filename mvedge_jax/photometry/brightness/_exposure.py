"""Brightness of the views: exposure of the whole light field, gain and vignette of each view."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._root import safe_sqrt
from mvedge_jax.lightfield import LightField

from ._vignette import cropped, falloff


class Exposure(NamedTuple):
    """Brightness factors of the views.

    Attributes:
        scale: factor for all views that brightens dark scenes, from 1 to `Brightness.brightest`.
        gain: brightness of each view relative to the center view, `[v, u]`, or of each photograph
            relative to the first, `[s]`; views are divided by it. 1 for views that were not
            measured.
        vignette: variation of the log of that brightness over the frame of the view: coefficients
            `[..., i, j]` of the products of Legendre polynomials of degree `i` down and `j` across
            the frame, each of mean square 1; 0 if the variation is no larger than that of scenes
            without vignettes; None for 0 everywhere. Only ratios to the center view are observed,
            so its own vignette shows in parallax alone: a pixel that moves outwards becomes
            darker. The radial vignette common to all views is found along a disparity map with
            surfaces of different disparities side by side, and is part of the coefficients. The
            rest of the center view's vignette stays in all views.
    """

    scale: Float[Array, ""]
    gain: Float[Array, "*views"]
    vignette: Float[Array, "*views 4 4"] | None = None

    @property
    def unevenness(self) -> Float[Array, "*views"]:
        """Standard deviation over the frame of each log vignette relative to the center view's."""
        if self.vignette is None:
            return jnp.zeros_like(self.gain)
        shape = self.gain.shape
        own = self.vignette[tuple(n // 2 for n in shape) if len(shape) == 2 else 0]
        # The polynomials are orthonormal.
        change = self.vignette - jnp.broadcast_to(own, self.vignette.shape)
        return safe_sqrt(jnp.sum(change**2, axis=(-2, -1)))

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
        """Factors of pixels that remove exposure, gain and vignette.

        Args:
            views: index of an axis of the grid, or of both.
            shape: rows and columns of the views.

        Returns:
            Factors of every view and pixel, or of every view, `[..., 1, 1]`, without vignettes.
        """
        factor = (self.scale / self.gain[views])[..., None, None]
        return factor if self.vignette is None else factor * falloff(self.vignette[views], shape)


def expose(light_field: LightField, exposure: Exposure) -> LightField:
    """Removes exposure and gains from the views.

    Args:
        light_field: the raw views.
        exposure: exposure and gains to remove.

    Returns:
        The light field with comparable colors; bright pixels may exceed 1. Differentiable.

    Example:
        >>> import jax.numpy as jnp
        >>> dark = LightField(jnp.full((3, 3, 8, 8, 3), 0.1))
        >>> exposed = expose(dark, Exposure(jnp.asarray(5.0), jnp.ones((3, 3))))
        >>> bool(jnp.allclose(exposed.views, 0.5))
        True
    """
    factor = exposure.factors(..., light_field.views.shape[2:4])[..., None]
    return eqx.tree_at(lambda field: field.views, light_field, light_field.views * factor)
