"""Keeping XLA from fusing one computation into the next."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax


def fenced(function: Callable[..., Any], *arguments: Any) -> Any:
    """Calls `function` so that its results are computed once and stored.

    XLA on the CPU fuses chains of stencils and computes every intermediate anew for each of its
    readers, which grows like 9 to the power of the length of the chain. A barrier does not help,
    as it is removed before fusion, but the branch of a conditional is compiled by itself. The
    barrier keeps the condition from being recognised as constant.
    """
    shapes = jax.eval_shape(function, *arguments)
    always = lax.optimization_barrier(jnp.asarray(True))
    return lax.cond(
        always,
        function,
        lambda *_: jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes),
        *arguments,
    )
