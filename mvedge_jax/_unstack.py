"""Taking stacked planes apart without paying for it in reverse mode."""

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Shaped

from mvedge_jax._linear_map import linear_map


def unstack(planes: Shaped[Array, "n *s"]) -> list[Array]:
    """The planes of a stack, as `list(planes)` has them.

    The transpose of every index is a stack of zeros with one plane set, and all of these are
    added; that of a split is one concatenation.

    Args:
        planes: stacked along the first axis.

    Returns:
        One array per plane.
    """
    count = planes.shape[0]
    if count == 0:
        return []
    return [lax.squeeze(part, (0,)) for part in lax.split(planes, (1,) * count)]


def plane_sum(planes: Float[Array, "n *s"]) -> Float[Array, "*s"]:
    """The sum of a stack, plane by plane: XLA on CPU vectorises none over a leading axis.

    Args:
        planes: stacked along the first axis; may be none.

    Returns:
        Their sum. By itself, JAX would put the planes' cotangents together again, one by one.
    """
    return linear_map(_added, lambda _, ct: jnp.broadcast_to(ct, planes.shape), None, planes)


def _added(_: None, planes: Array) -> Array:
    parts = unstack(planes)
    return sum(parts[1:], parts[0]) if parts else jnp.zeros(planes.shape[1:], planes.dtype)
