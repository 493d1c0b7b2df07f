"""One linear solve with a prepared preconditioner, and what `vmap` makes of it."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array

from . import _banded, _lahbpcg, _multigrid
from ._coarsen import ratio
from ._pcg import Iterate, pcg
from ._stencil import Coefficients, diagonal, largest, reachable

# Pixels that are solved together under `vmap`. Images of more than half of that are solved one
# after the other: each stops on its own and stays in the cache. Smaller ones share operations, so
# that these are long enough to be worth starting; larger groups leave the cache and wait for the
# slowest member.
_TOGETHER = 1 << 14
# Entries of the inverses of a column that are worked on together: as many as fit in the fastest
# cache (512 images of 9x512, on one device: 74 ms in groups of 64, 79 of 32, 109 of 16).
_WINDOW = 64 * 9 * 9
# Thin images that are worth eliminating: the cost per pixel grows with the square of the short
# side, and columns come one after the other.
_THIN, _SHORT = 16, 1 << 14
# Multigrid was not seen to miss a region where edges are less uneven than this.
_EVEN, _PROBES = 1e5, 4


class Options(NamedTuple):
    """What selects a compiled solver. The preconditioner is never `"auto"` here."""

    preconditioner: str
    stop: str
    max_iterations: int


class Prepared(NamedTuple):
    """A matrix, what its preconditioner needs, and which pixels are tied to data."""

    coefficients: Coefficients
    hierarchy: Any
    keep: Array


def choose(preconditioner: str, shape: tuple[int, int]) -> str:
    """What `"auto"` stands for at an image size."""
    if preconditioner != "auto":
        return preconditioner
    thin = min(shape) <= _THIN and shape[0] * shape[1] <= _SHORT
    return "banded" if thin else "multigrid"


def prepare(options: Options, coefficients: Coefficients) -> Prepared:
    """Computes everything about a matrix that a solve and its adjoint share."""
    return Prepared(coefficients, *mapped(prepare_group, options)(coefficients))


def prepare_group(options: Options, coefficients: Coefficients) -> tuple[Any, Array]:
    """Hierarchy and tied pixels of one matrix, or of some on a leading axis."""
    if options.preconditioner == "multigrid":
        hierarchy = _multigrid.build(coefficients)
    elif options.preconditioner == "lahbpcg":
        hierarchy = _lahbpcg.build(coefficients)
    elif options.preconditioner == "jacobi":
        hierarchy = diagonal(coefficients)
    else:
        # Inverses take `h` times the memory of an image: every solve makes them anew.
        hierarchy = ()
    return hierarchy, reachable(coefficients)


def preconditioner(options: Options, prepared: Prepared) -> Callable[[Array], Array]:
    """The approximate inverse as a function; the elimination of thin images needs none."""
    hierarchy = prepared.hierarchy
    if options.preconditioner == "multigrid":
        return _multigrid.cycle(hierarchy)
    if options.preconditioner == "lahbpcg":
        return _lahbpcg.solver(hierarchy)
    return lambda residual: ratio(residual, hierarchy)


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
    return mapped(solve_group, options)(prepared, right, absolute, relative)


def solve_group(
    options: Options, prepared: Prepared, right: Array, absolute: Array, relative: Array
) -> Iterate:
    """`solve` for one system, or for some on a leading axis."""
    right = jnp.where(prepared.keep, right, 0)
    limits = {"stop": options.stop, "max_iterations": options.max_iterations}
    if options.preconditioner == "banded":
        return _banded.refine(
            prepared.coefficients, right, prepared.keep, absolute, relative, **limits
        )
    return pcg(
        prepared.coefficients,
        preconditioner(options, prepared),
        right,
        prepared.keep,
        absolute,
        relative,
        probes=_probes(options, prepared.coefficients),
        **limits,
    )


def _probes(options: Options, coefficients: Coefficients) -> Array:
    """How often to probe the preconditioner: not at all where it has nothing to miss."""
    _, tx, ty = coefficients
    none = jnp.zeros(coefficients.weight.shape[:-2], jnp.int32)
    if options.preconditioner != "multigrid" or options.stop != "error":
        return none
    strong = jnp.maximum(largest(tx), largest(ty))
    weak = jnp.minimum(_least(tx), _least(ty))
    return jnp.where(strong > _EVEN * weak, _PROBES, none)


def _least(edges: Array) -> Array:
    """Smallest edge weight that is not zero, per image of a batch."""
    return jnp.min(jnp.where(edges > 0, edges, jnp.inf), axis=(-2, -1), initial=jnp.inf)


@lru_cache(maxsize=64)
def mapped(function: Callable[..., Any], options: Options) -> Callable[..., Any]:
    """`function` for one system, or a batch on the first axis of every argument, under `vmap`.

    Members of a batch are handled in turn, or in groups if they are small.
    """

    @custom_vmap
    def run(*arguments: Any) -> Any:
        return function(options, *arguments)

    @custom_vmap
    def run_group(*arguments: Any) -> Any:
        return function(options, *arguments)

    def in_turn(size: int, batched: Any, arguments: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        moving = jax.tree.leaves(tuple(batched))

        def one(rows: list[Array]) -> Any:
            left = list(rows)
            whole = [left.pop(0) if b else leaf for b, leaf in zip(moving, leaves, strict=True)]
            return run(*jax.tree.unflatten(structure, whole))

        return lax.map(one, [leaf for b, leaf in zip(moving, leaves, strict=True) if b])

    def in_groups(size: int, arguments: Any) -> Any:
        group = _group(options, arguments)
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
        if _group(options, arguments) == 1:
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


def _group(options: Options, arguments: Any) -> int:
    """How many members are solved together, from the size of the first image."""
    y, x = jax.tree.leaves(arguments)[0].shape[-2:]
    if options.preconditioner == "banded":
        return max(_WINDOW // min(y, x) ** 2, 1)
    return max(_TOGETHER // (y * x), 1)


def _broadcast(size: int, batched: Any, arguments: Any) -> Any:
    return jax.tree.map(
        lambda b, a: a if b else jnp.broadcast_to(a, (size, *a.shape)), tuple(batched), arguments
    )
