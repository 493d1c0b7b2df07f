"""A square root that has a derivative everywhere, and the least that is divided by."""

import jax.numpy as jnp
from jaxtyping import Array, Float

# Guards divisions: derivatives hold the inverse squared, which is still a number in float32.
LEAST_DIVISOR = 1e-9


def safe_sqrt(square: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Square root with the derivative 0 at 0, where it has none: equal colors have no direction."""
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
