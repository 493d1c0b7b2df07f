"""One program for two like things, such as both arms of a crosshair."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax

from mvedge_jax._fence import fenced

_In = TypeVar("_In")
_Out = TypeVar("_Out")


def of_both(function: Callable[[_In], _Out], first: _In, second: _In) -> tuple[_Out, _Out]:
    """Calls a function on each of two pytrees: by a loop, where all of their shapes agree.

    A loop is compiled once, and what is compiled is what a first call waits for. Views of square
    images in a square grid have two arms of one shape.

    Args:
        function: maps a pytree of arrays to such.
        first: a pytree of arrays.
        second: a pytree of the same structure.

    Returns:
        The results, in order, computed once and stored (`fenced`). Differentiable as `function` is.
    """
    pair = first, second
    if len({tuple(map(jax.typeof, jax.tree.leaves(of))) for of in pair}) > 1:
        return fenced(function, first), fenced(function, second)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *pair)
    found = lax.map(function, stacked)
    across, down = (jax.tree.map(lambda leaf, i=i: leaf[i], found) for i in range(2))
    return across, down
