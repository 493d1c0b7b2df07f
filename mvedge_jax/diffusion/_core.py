"""One linear solve with a prepared preconditioner, and what `vmap` makes of it."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array

from . import _multigrid
from ._pcg import Iterate, pcg
from ._stencil import Coefficients, reachable

# Images of at least this many pixels are solved one after the other under `vmap`: each stops on
# its own and stays in the cache. Smaller ones share every operation, which hides its overhead.
_LARGE = 1 << 14


class Options(NamedTuple):
    """What selects a compiled solver."""

    preconditioner: str
    stop: str
    max_iterations: int


class Prepared(NamedTuple):
    """A matrix, the hierarchy of its preconditioner, and which pixels are tied to data."""

    coefficients: Coefficients
    hierarchy: Any
    keep: Array


def prepare(options: Options, coefficients: Coefficients) -> Prepared:
    """Computes everything about a matrix that a solve and its adjoint share."""
    return Prepared(coefficients, _multigrid.build(coefficients), reachable(coefficients))


def solve(
    options: Options, prepared: Prepared, right: Array, absolute: Array, relative: Array
) -> Iterate:
    """Solves `A x = right` from zero until the error is below `absolute + relative max |x|`.

    Args:
        options: static choices.
        prepared: of the matrix.
        right: right-hand side, `[y, x]`; ignored where the matrix is singular.
        absolute: part of the threshold, unit of `x` (of `right` if residuals are measured).
        relative: part of the threshold, share of the largest entry of `x`.

    Returns:
        The solution and its statistics.
    """
    return _single(options)(prepared, right, absolute, relative)


def _run(
    options: Options, prepared: Prepared, right: Array, absolute: Array, relative: Array
) -> Iterate:
    return pcg(
        prepared.coefficients,
        _multigrid.cycle(prepared.hierarchy),
        jnp.where(prepared.keep, right, 0),
        prepared.keep,
        absolute,
        relative,
        stop=options.stop,
        max_iterations=options.max_iterations,
    )


@lru_cache(maxsize=64)
def _single(options: Options) -> Callable[..., Iterate]:
    """The solver of one image."""

    @custom_vmap
    def run(prepared: Prepared, right: Array, absolute: Array, relative: Array) -> Iterate:
        return _run(options, prepared, right, absolute, relative)

    @run.def_vmap
    def rule(size: int, batched: Any, *arguments: Any) -> tuple[Iterate, Iterate]:
        result = _map(options, size, batched, arguments)
        return result, jax.tree.map(lambda _: True, result)

    return run


@lru_cache(maxsize=64)
def _batch(options: Options) -> Callable[..., Iterate]:
    """The solver of a batch of small images, the batch on the first axis of every argument."""

    @custom_vmap
    def run(prepared: Prepared, right: Array, absolute: Array, relative: Array) -> Iterate:
        return _run(options, prepared, right, absolute, relative)

    @run.def_vmap
    def rule(size: int, batched: Any, *arguments: Any) -> tuple[Iterate, Iterate]:
        arguments = _broadcast(size, batched, arguments)
        inner = arguments[1].shape[1]
        flat = jax.tree.map(lambda a: a.reshape(size * inner, *a.shape[2:]), arguments)
        result = jax.tree.map(
            lambda a: a.reshape(size, inner, *a.shape[1:]), _batch(options)(*flat)
        )
        return result, jax.tree.map(lambda _: True, result)

    return run


def _broadcast(size: int, batched: Any, arguments: Any) -> Any:
    return jax.tree.map(
        lambda b, a: a if b else jnp.broadcast_to(a, (size, *a.shape)), tuple(batched), arguments
    )


def _map(options: Options, size: int, batched: Any, arguments: Any) -> Iterate:
    right = arguments[1]
    if right.shape[-2] * right.shape[-1] < _LARGE:
        return _batch(options)(*_broadcast(size, batched, arguments))
    leaves, structure = jax.tree.flatten(arguments)
    moving = jax.tree.leaves(tuple(batched))

    def one(rows: list[Array]) -> Iterate:
        rows = list(rows)
        whole = [rows.pop(0) if b else leaf for b, leaf in zip(moving, leaves, strict=True)]
        return _single(options)(*jax.tree.unflatten(structure, whole))

    return lax.map(one, [leaf for b, leaf in zip(moving, leaves, strict=True) if b])
