"""Standard error of a map: that of its labels, of what has none, and of the place of its steps."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax._root import root


class StandardError(eqx.Module):
    """From standard errors of labels to those of the map.

    Defaults are from cotton, backgammon, room, bench and nine rendered scenes: 93 % of all pixels
    are within twice the error (`experiments/calibration.py`).

    Attributes:
        shared: factor of the labels' errors: labels beside each other share views and windows, so
            that their mean is known less well than their own standard errors say.
        alike: the map's own spread is believed as far as perfect labels outnumber these, which a
            window of 7x7 pixels shares. With fewer, anything within the range searched may be true.
        misplaced: a depth step is found to this distance.
        forgotten: distance from any label beyond which a map tells no more about a surface than its
            own spread.
    """

    shared: Float[Array, ""] = number(1.2)
    alike: Float[Array, ""] = number(49.0, "perfect labels")
    misplaced: Float[Array, ""] = number(0.5, "px")
    forgotten: Float[Array, ""] = number(55.0, "px")

    def __call__(
        self, of_labels: Float[Array, "y x"], disparity: Float[Array, "y x"]
    ) -> Float[Array, "y x"]:
        """Standard error of a map.

        Args:
            of_labels: standard error of the labels that a pixel is made from, px; 0 without labels.
            disparity: the map, px.

        Returns:
            px; infinite without labels. Differentiable.
        """
        params = cast(self, disparity.dtype)
        edge = params.misplaced * steepest(disparity)
        known = of_labels > 0
        labels = params.shared * jnp.where(known, of_labels, 1)
        return jnp.where(known, jnp.sqrt(labels**2 + edge**2), jnp.inf)

    def spread(self, disparity: Array, weight: Array, span: Array) -> Array:
        """How far from the map a surface without labels may be: by the map, or by the range.

        Args:
            disparity: the map, any shape.
            weight: of the labels, 1/variance against a perfect one, broadcastable.
            span: width of the range that was searched.

        Returns:
            A standard error, one number. Differentiable.
        """
        evidence = jnp.sum(weight)
        variance = evidence * jnp.var(disparity) + self.alike * span**2
        return root(variance / (evidence + self.alike))


def steepest(disparity: Array) -> Array:
    """Largest difference from a direct neighbor.

    Args:
        disparity: a map, [y, x].

    Returns:
        Of its shape. Differentiable.
    """
    across, down = jnp.abs(jnp.diff(disparity, axis=1)), jnp.abs(jnp.diff(disparity, axis=0))
    most = jnp.zeros_like(disparity)
    for side in ((0, 1), (1, 0)):
        most = jnp.maximum(most, jnp.pad(across, ((0, 0), side)))
        most = jnp.maximum(most, jnp.pad(down, (side, (0, 0))))
    return most
