"""How well photographs agree on a hypothesis: correlation of windows, soft minimum over them."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._cpu import plane_sum
from mvedge_jax._params import number

from .._window import weighted_sum


class Agreement(eqx.Module):
    """Parameters of the costs of a few photographs far apart.

    Attributes:
        correlation: share of the correlation of windows in a cost, which gloss and gains change
            little; the rest is the truncated difference of colors.
        contrast: variance of a window's colors at which its correlation is halved, so that windows
            without texture agree with none.
        temperature: how much more than the best photograph another one may cost before its share
            in the cost of a hypothesis falls to 1/e: it may be hidden there.
    """

    correlation: Float[Array, ""] = number(0.5)
    contrast: Float[Array, ""] = number(2.0, "noise variances")
    temperature: Float[Array, ""] = number(0.1, "of a cost of at most 1")

    def pooled(self, costs: Float[Array, "s y x"]) -> Float[Array, "y x"]:
        r"""Soft minimum over the photographs, $-T \ln \mathrm{mean}\, e^{-c / T}$.

        Args:
            costs: of every photograph, at most 1.

        Returns:
            A cost between the least one and the mean. Differentiable.
        """
        least = jnp.min(costs, axis=0)
        share = plane_sum(jnp.exp((least[None] - costs) / self.temperature)) / costs.shape[0]
        return least - self.temperature * jnp.log(share)


class Window(eqx.Module):
    """A window around every pixel of the reference, and what its correlations need.

    Attributes:
        colors: of the reference, `[c, y, x]`.
        weights: of the window's pixels.
        mean: of the window's colors.
        energy: squared contrast of the window, plus that which halves a correlation.
        floor: the latter.
    """

    colors: Float[Array, "c y x"]
    weights: Float[Array, "o y x"]
    mean: Float[Array, "c y x"]
    energy: Float[Array, "y x"]
    floor: Float[Array, ""]

    @staticmethod
    def of(
        colors: Float[Array, "c y x"], weights: Float[Array, "o y x"], floor: Float[Array, ""]
    ) -> "Window":
        """The windows of a reference."""
        mean = weighted_sum(colors, weights)
        square = weighted_sum(plane_sum(colors**2)[None], weights)[0]
        spread = jnp.maximum(square - plane_sum(mean**2), 0)
        return Window(colors, weights, mean, spread + floor, floor)

    def unlike(self, other: Float[Array, "c y x"]) -> Float[Array, "y x"]:
        """Cost of a photograph's colors at the pixels of the reference.

        Args:
            other: the colors.

        Returns:
            0 where a window correlates with that of the reference, one half where it does not, 1
            where it is its negative. Differentiable.
        """
        products = jnp.stack([plane_sum(other * self.colors), plane_sum(other**2)])
        *mean, product, square = weighted_sum(jnp.concatenate([other, products]), self.weights)
        both, own = jnp.zeros_like(product), jnp.zeros_like(product)
        for there, here in zip(mean, self.mean, strict=True):
            both, own = both + there * here, own + there**2
        energy = (jnp.maximum(square - own, 0) + self.floor) * self.energy
        return 0.5 * (1 - (product - both) / jnp.sqrt(energy))
