"""Keeping XLA from fusing one computation into the next."""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.ad_checkpoint import checkpoint_name
from jax.extend.core import Primitive

_Tree = TypeVar("_Tree")
_KEPT = "mvedge_jax: kept"


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


def staged(function: Callable[..., Any]) -> Callable[..., Any]:
    """A stage of a long computation, of which reverse mode keeps the arguments only.

    `jax.checkpoint` alone does not say when a stage is computed again: on the CPU, XLA is free to
    do so for all stages at once, long before their cotangents are there, and to keep everything.
    The arguments of a conditional have to be there first, and the cotangents are among them.

    Args:
        function: maps pytrees of arrays to such.

    Returns:
        The same function. Differentiable as it is, in both modes.
    """

    def stage(*arguments: Any) -> Any:
        # What is no array, such as an activation of a user's network, is closed over.
        arrays, rest = eqx.partition(arguments, _is_array)

        def of_arrays(arrays: Any) -> Any:
            return function(*eqx.combine(arrays, rest))

        return fenced(recomputed(of_arrays), arrays)

    return stage


def recomputed(function: Callable[..., Any]) -> Callable[..., Any]:
    """`jax.checkpoint` that keeps what is small but dear: linear solutions, and what is `kept`.

    Args:
        function: maps pytrees of arrays to such.

    Returns:
        The same function. Differentiable as it is, in both modes.
    """
    return jax.checkpoint(function, policy=_is_small_but_dear)


def kept(tree: _Tree) -> _Tree:
    """Arrays that reverse mode keeps where all around them is `recomputed`.

    Args:
        tree: a pytree of arrays.

    Returns:
        The same.
    """
    return jax.tree.map(lambda array: checkpoint_name(array, _KEPT), tree)


def _is_array(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, np.ndarray)


def _is_small_but_dear(primitive: Primitive, *_: Any, **params: Any) -> bool:
    return primitive.name == "custom_linear_solve" or params.get("name") == _KEPT
