"""Edge weights from a smoothness map."""

from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy

Pairing = Literal["min", "mean", "harmonic", "second"]


@accepts_numpy
def edge_weights(
    smoothness: Float[Array, "y x"], *, pairing: str = "min"
) -> tuple[Float[Array, "y x-1"], Float[Array, "y-1 x"]]:
    r"""Turns one smoothness per pixel into one weight per edge.

    The thesis writes one number per pixel, $\lambda_s(p)$, for a term that lives on the edge
    $(p, q)$, and leaves the pairing open.

    Args:
        smoothness: per pixel, `[y, x]`, ≥ 0, such as `0.1 / (|grad I|² + 1e-5)`.
        pairing: how the two pixels of an edge agree. `"min"` cuts an edge as soon as one of its
            pixels is on an image edge and is symmetric; `"mean"` needs both, and is the weight
            that visiting each edge from both ends would give, up to a factor of 2; `"harmonic"`
            puts the two half-edges in series; `"second"` takes the right or lower pixel, as the
            authors' code does, and moves every cut by half a pixel.

    Returns:
        `tx`, `[y, x - 1]`, and `ty`, `[y - 1, x]`. Differentiable (with `"min"`, half of the
        gradient goes to either pixel where both are equal).

    Source: Thesis 6.1, Eq. 6.2.

    Example:
        >>> import jax.numpy as jnp
        >>> tx, ty = edge_weights(jnp.array([[1.0, 3.0, 2.0]]))
        >>> tx.tolist(), ty.shape
        ([[1.0, 2.0]], (0, 3))
    """
    pairs = (
        (smoothness[:, :-1], smoothness[:, 1:]),
        (smoothness[:-1], smoothness[1:]),
    )
    if pairing == "min":
        tx, ty = (jnp.minimum(a, b) for a, b in pairs)
    elif pairing == "mean":
        tx, ty = (0.5 * (a + b) for a, b in pairs)
    elif pairing == "harmonic":
        tx, ty = (_harmonic(a, b) for a, b in pairs)
    elif pairing == "second":
        tx, ty = (b for _, b in pairs)
    else:
        raise ValueError(
            f"`pairing` must be 'min', 'mean', 'harmonic' or 'second'; it is {pairing!r}."
        )
    return tx, ty


def _harmonic(a: Array, b: Array) -> Array:
    total = a + b
    return jnp.where(total > 0, 2 * a * b / jnp.where(total > 0, total, 1), 0)
