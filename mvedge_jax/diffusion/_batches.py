"""Solvers under `vmap`: members of a batch in turn, or in groups if they are small."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array


@lru_cache(maxsize=64)
def mapped(function: Callable[..., Any], solver: Any) -> Callable[..., Any]:
    """`function` for one system, or for a batch on the first axis of every argument, under `vmap`.

    Args:
        function: maps a solver and arrays to arrays; the arrays may have a leading axis.
        solver: without arrays, so that it can be told from others; `together` says how many members
            share a call.
    """

    @custom_vmap
    def run(*arguments: Any) -> Any:
        return function(solver, *arguments)

    @custom_vmap
    def run_group(*arguments: Any) -> Any:
        return function(solver, *arguments)

    def in_turn(size: int, batched: Any, arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        moving = jax.tree.leaves(tuple(batched))

        def one(rows: list[Array]) -> Any:
            left = list(rows)
            whole = [left.pop(0) if b else leaf for b, leaf in zip(moving, leaves, strict=True)]
            return run(*jax.tree.unflatten(structure, whole))

        return lax.map(one, [leaf for b, leaf in zip(moving, leaves, strict=True) if b])

    def in_groups(size: int, arguments: Any) -> Any:
        group = _group(solver, arguments)
        if size <= group:
            return run_group(*arguments)
        count = -(-size // group)
        # The last group is filled up with the first members once more.
        order = np.arange(count * group) % size
        full = arguments if count * group == size else jax.tree.map(lambda a: a[order], arguments)
        groups = jax.tree.map(lambda a: a.reshape(count, group, *a.shape[1:]), full)
        result = lax.map(lambda members: run_group(*members), groups)
        return jax.tree.map(lambda a: a.reshape(count * group, *a.shape[2:])[:size], result)

    @run.def_vmap
    def rule(size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        if _group(solver, arguments) == 1:
            result = in_turn(size, batched, arguments)
        else:
            result = in_groups(size, _broadcast(size, batched, arguments))
        return result, jax.tree.map(lambda _: True, result)

    @run_group.def_vmap
    def group_rule(size: int, batched: Any, *arguments: Any) -> tuple[Any, Any]:
        arguments = _broadcast(size, batched, arguments)
        inner = jax.tree.leaves(arguments)[0].shape[1]
        flat = jax.tree.map(lambda a: a.reshape(size * inner, *a.shape[2:]), arguments)
        result = in_groups(size * inner, flat)
        result = jax.tree.map(lambda a: a.reshape(size, inner, *a.shape[1:]), result)
        return result, jax.tree.map(lambda _: True, result)

    return run


def _group(solver: Any, arguments: Any) -> int:
    """Number of members solved together, by the size of the first image."""
    y, x = jax.tree.leaves(arguments)[0].shape[-2:]
    return solver.together((y, x))


def _broadcast(size: int, batched: Any, arguments: Any) -> Any:
    return jax.tree.map(
        lambda b, a: a if b else jnp.broadcast_to(a, (size, *a.shape)), tuple(batched), arguments
    )
