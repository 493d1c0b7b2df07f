"""The thesis' smoothness terms: one number per pixel."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax.diffusion import Pairing, edge_weights
from mvedge_jax.image import gradient_square


class PerPixel(eqx.Module):
    """A smoothness with one number per pixel; each edge combines those of its two pixels.

    Attributes:
        floor: least smoothness.
        pairing: how an edge combines the smoothness of two pixels, see `edge_weights`.
    """

    floor: Float[Array, ""] = number(1e-4)
    pairing: Pairing = eqx.field(static=True, default="min")

    @abc.abstractmethod
    def per_pixel(
        self, guide: Float[Array, "c y x"], depth_edge: Float[Array, "y x"]
    ) -> Float[Array, "y x"]:
        """Smoothness per pixel, at most 1 and not yet bounded below; arguments as `Smoothness`."""

    def __call__(
        self,
        guide: Float[Array, "c y x"],
        disparity: Float[Array, "y x"],
        depth_edge: Float[Array, "y x"],
    ) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
        """See `Smoothness`; the map is not read."""
        params = cast(self, disparity.dtype)
        smooth = jnp.maximum(params.per_pixel(guide, depth_edge), params.floor)
        return edge_weights(smooth, pairing=self.pairing)


class ThesisSmoothness(PerPixel):
    r"""Smoothness that is inverse to the depth-edge confidence, $s / (s + \lambda_s)$.

    Attributes:
        depth_edge: $s$, the confidence at which the smoothness is one half; not given in the
            thesis. Maps hardly depend on it below 1e-3.
        floor: see `PerPixel`.
        pairing: see `PerPixel`.

    Source: Thesis 4.3 and 6.1.
    """

    depth_edge: Float[Array, ""] = number(1e-3, "px/px")
    floor: Float[Array, ""] = number(1e-6)

    def per_pixel(
        self, guide: Float[Array, "c y x"], depth_edge: Float[Array, "y x"]
    ) -> Float[Array, "y x"]:
        """See `PerPixel`; colors are ignored."""
        del guide
        return self.depth_edge / (self.depth_edge + depth_edge)


class ImageGradient(PerPixel):
    r"""Smoothness that falls with the gradient of the image, $e^{-g |\nabla L|}$.

    Attributes:
        gain: g.
        floor: see `PerPixel`.
        pairing: see `PerPixel`.

    Source: Thesis 7.1.5, where Q starts as the image gradient.
    """

    gain: Float[Array, ""] = number(0.3, "px/L*")

    def per_pixel(
        self, guide: Float[Array, "c y x"], depth_edge: Float[Array, "y x"]
    ) -> Float[Array, "y x"]:
        """See `PerPixel`; only lightness is read."""
        del depth_edge
        return jnp.exp(-image_roughness(guide[0], self.gain))


def image_roughness(lightness: Float[Array, "y x"], gain: Float[Array, ""]) -> Float[Array, "y x"]:
    """The magnitude of the image gradient by central differences, scaled.

    Args:
        lightness: L* in 0..100.
        gain: per unit of L* per pixel.

    Returns:
        At least 0. Differentiable, also where the image is flat.
    """
    return gain * jnp.sqrt(gradient_square(lightness) + 1e-12)
