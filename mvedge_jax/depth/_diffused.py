"""Diffusion of labels into a map and its error, along the slopes of the previous map."""

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jax import lax
from jaxtyping import Array

from mvedge_jax._params import cast
from mvedge_jax.diffusion import AbstractSolver, System, diffuse

from ._labels import Labels
from ._refine import Refine
from ._slopes import rises, slope_labels

_Solver = TypeVar("_Solver", bound=lx.AbstractLinearSolver)

# Indices of the diffused quantities; the slopes follow if there are any.
_MAP, _ERROR, _SLOPES = 0, 1, 2


class _Solve(NamedTuple):
    """One diffusion: of either slope, of the map or of its error.

    Attributes:
        which: index of the diffused quantity.
        wanted: whether this step computes it.
        weight: data weights of the labels.
        label: the values to diffuse.
        stiffness: weight of an uncut edge.
        coarser: factor of the tolerance.
    """

    which: Array
    wanted: Array
    weight: Array
    label: Array
    stiffness: Array
    coarser: Array


def diffused(
    labels: Labels,
    edges: tuple[Array, Array],
    start: Array,
    span: Array,
    params: Refine,
    solver: lx.AbstractLinearSolver,
    *,
    sloped: Array,
    last: Array,
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Diffuses labels into a map, from `start`; if `sloped`, along the slopes of `start`.

    The slopes (if `Refine` has them), the map and, at `last`, its error are solved one after the
    other in a loop, because the solver compiles slowly.

    Args:
        labels: labels of every pixel, with weight 0 where there is none.
        edges: smoothness between neighbors, in (0, 1].
        start: the previous map, px.
        span: width of the range that was searched, px.
        params: see `Refine`.
        solver: solver of the map. Slopes and errors stop at `Refine.coarser` times its tolerance
            if it is a solver of this package.
        sloped: whether the map is diffused along the slopes of `start`.
        last: whether to compute the error of the map.

    Returns:
        The map and, at `last`, the standard error of the labels that every pixel is made from, 0
        without labels; iterations and convergence of the map's own solve.
    """
    # Standard error of a label of this weight, at least a tenth of `precision`.
    uncertain = params.precision * jnp.sqrt(1 / jnp.clip(labels.weight, 1e-9, 0.99) - 1)
    whole, nothing = params.stiffness, jnp.zeros_like(start)
    forgotten = whole / params.error.forgotten**2
    doubted = labels.weight + forgotten
    spread = params.error.spread(start, labels.weight, span)
    doubt = (labels.weight * uncertain + forgotten * spread) / doubted
    coarser, alike = params.coarser.astype(start.dtype), jnp.ones((), start.dtype)
    turns = [
        _Solve(jnp.asarray(_MAP), jnp.asarray(True), labels.weight, labels.value, whole, alike),
        _Solve(jnp.asarray(_ERROR), last, doubted, doubt, whole, coarser),
    ]
    if params.slopes is not None:
        bent = cast(params.slopes, start.dtype)
        held, slopes = slope_labels(start, labels.weight, edges, bent)
        turns = [
            _Solve(jnp.asarray(_SLOPES + i), sloped, *of, bent.stiffness, coarser)
            for i, of in enumerate(zip(held, slopes, strict=True))
        ] + turns
    solves = jax.tree.map(lambda *leaves: jnp.stack(leaves), *turns)

    def solve(found: Array, of: _Solve) -> tuple[Array, tuple[Array, Array]]:
        asked = ()
        if params.slopes is not None:
            asked = [jnp.where(of.which == _MAP, rise, 0) for rise in rises(found[_SLOPES:])]
        tx, ty = (of.stiffness * t for t in edges)

        def solved() -> tuple[Array, tuple[Array, Array]]:
            system = System(of.weight, of.label, tx, ty, *asked)
            first = jnp.where(of.which == _MAP, start, nothing)
            result = diffuse(system, start=first, solver=_coarser(solver, of.coarser))
            return result.value, (result.stats.iterations, result.stats.converged)

        def skipped() -> tuple[Array, tuple[Array, Array]]:
            return nothing, (jnp.zeros((), jnp.int32), jnp.asarray(True))

        value, stats = lax.cond(of.wanted, solved, skipped)
        return lax.dynamic_update_index_in_dim(found, value, of.which, 0), stats

    found, (iterations, converged) = lax.scan(solve, jnp.zeros_like(solves.label), solves)
    # The map is solved last but one.
    return (found[_MAP], found[_ERROR]), (iterations[-2], jnp.all(converged))


def _coarser(solver: _Solver, factor: Array) -> _Solver:
    """Scales the tolerance of this package's solvers; returns others as they are."""
    if not isinstance(solver, AbstractSolver):
        return solver
    tolerance: Any = solver.tolerance
    return eqx.tree_at(lambda s: s.tolerance, solver, tolerance * factor)
