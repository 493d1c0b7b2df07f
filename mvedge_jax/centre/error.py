"""Standard error of a map: that of its labels, of what has none, and of the place of its steps."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._root import root

# Labels beside each other share views and windows, so that their mean is known less well than their
# own standard errors say. From five scenes, in which 93 % of all pixels are then within twice the
# error (`experiments/calibration.py`).
_SHARED = 1.2
# The map's own spread is believed as far as perfect labels outnumber these, which a window of 7x7
# pixels shares. With fewer, anything within the range that was tried may be true.
_ALIKE = 49.0
# A depth step is found to half a pixel.
_MISPLACED = 0.5


def standard_error(
    of_labels: Float[Array, "y x"], disparity: Float[Array, "y x"]
) -> Float[Array, "y x"]:
    """That of the labels, and of the place of the map's steps; infinite without labels.

    Args:
        of_labels: `Map.error`.
        disparity: the map.

    Returns:
        Standard error of the map. Differentiable.
    """
    edge = _MISPLACED * steepest(disparity)
    known = of_labels > 0
    labels = _SHARED * jnp.where(known, of_labels, 1)
    return jnp.where(known, jnp.sqrt(labels**2 + edge**2), jnp.inf)


def spread(disparity: Array, weight: Array, span: Array) -> Array:
    """How far from the map a surface without labels may be: by the map, or else by the range.

    Args:
        disparity: the map, any shape.
        weight: of the labels, 1/variance against a perfect one, broadcastable.
        span: width of the range that was tried.

    Returns:
        A standard error, one number. Differentiable.
    """
    evidence = jnp.sum(weight)
    variance = evidence * jnp.var(disparity) + _ALIKE * span**2
    return root(variance / (evidence + _ALIKE))


def steepest(disparity: Array) -> Array:
    """Largest difference from a direct neighbour.

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
