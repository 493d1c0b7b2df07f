"""Labels diffused into a map and its error, along the slopes of the map before."""

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

# Places of what is diffused; those of the slopes follow, where there are any.
_MAP, _ERROR, _SLOPES = 0, 1, 2


class _Solve(NamedTuple):
    """One diffusion: of either slope, of the map or of its error.

    Attributes:
        which: the place of what is diffused.
        wanted: whether it is asked for in this turn.
        weight: of the labels.
        label: what is diffused.
        start: of the solver.
        stiffness: weight of an uncut edge.
        coarser: multiplies the tolerance.
    """

    which: Array
    wanted: Array
    weight: Array
    label: Array
    start: Array
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

    For either slope (where `Refine` has them), for the map and, at `last`, for its error, a solve
    each, one after the other by a loop: the solver compiles slowly.

    Args:
        labels: of every pixel, of weight 0 where there is none.
        edges: smoothness between neighbors, in (0, 1].
        start: the map before.
        span: width of the range that was searched, px.
        params: see `Refine`.
        solver: of the map; slopes and errors stop at `Refine.coarser` times its tolerance, if it is
            of ours.
        sloped: whether the map is diffused along the slopes of `start`.
        last: whether the error of the map is asked for.

    Returns:
        The map and, at `last`, the standard error of the labels that every pixel is made from, 0
        without labels; iterations and convergence of the map's own solve.
    """
    # What a label of this weight is known to, and at best a tenth of what counts half.
    uncertain = params.precision * jnp.sqrt(1 / jnp.clip(labels.weight, 1e-9, 0.99) - 1)
    whole, nothing = params.stiffness, jnp.zeros_like(start)
    forgotten = whole / params.error.forgotten**2
    doubted = labels.weight + forgotten
    spread = params.error.spread(start, labels.weight, span)
    doubt = (labels.weight * uncertain + forgotten * spread) / doubted
    coarser, alike = params.coarser.astype(start.dtype), jnp.ones((), start.dtype)
    turns = [
        _Solve(
            jnp.asarray(_MAP), jnp.asarray(True), labels.weight, labels.value, start, whole, alike
        ),
        _Solve(jnp.asarray(_ERROR), last, doubted, doubt, nothing, whole, coarser),
    ]
    if params.slopes is not None:
        bent = cast(params.slopes, start.dtype)
        held, slopes = slope_labels(start, labels.weight, edges, bent)
        turns = [
            _Solve(jnp.asarray(_SLOPES + i), sloped, *of, nothing, bent.stiffness, coarser)
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
            result = diffuse(system, start=of.start, solver=_coarser(solver, of.coarser))
            return result.value, (result.stats.iterations, result.stats.converged)

        def skipped() -> tuple[Array, tuple[Array, Array]]:
            return nothing, (jnp.zeros((), jnp.int32), jnp.asarray(True))

        value, stats = lax.cond(of.wanted, solved, skipped)
        return lax.dynamic_update_index_in_dim(found, value, of.which, 0), stats

    found, (iterations, converged) = lax.scan(solve, jnp.zeros_like(solves.label), solves)
    # The map's own turn is the last but one.
    return (found[_MAP], found[_ERROR]), (iterations[-2], jnp.all(converged))


def _coarser(solver: _Solver, factor: Array) -> _Solver:
    """A solver of ours with another tolerance; others know their own."""
    if not isinstance(solver, AbstractSolver):
        return solver
    tolerance: Any = solver.tolerance
    return eqx.tree_at(lambda s: s.tolerance, solver, tolerance * factor)
