"""Taking stacked planes apart without paying for it in reverse mode."""

from jax import Array, lax
from jaxtyping import Shaped


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
