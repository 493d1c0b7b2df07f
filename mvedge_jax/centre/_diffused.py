"""Labels diffused into a map and its error, along the slopes of the map before."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from mvedge_jax.diffusion import AutoSolver, System, diffuse

from ._labels import Labels
from ._parameters import CentreParams
from ._slant import rises, slope_labels
from .error import spread

# Differences of neighbours beyond this, px, are steps rather than slopes.
_STEEPEST = 0.3
# Weight of the slope 0 against that of a perfect label.
_FLAT = 1e-4
# Beyond this distance from any label, px, a map tells no more about a surface than its own spread.
# From cotton, backgammon, room, bench and the nine rendered scenes.
_FORGOTTEN = 55.0
# Which of the four diffusions is which; those of the slopes come first.
_MAP, _ERROR = 2, 3


class _Solve(NamedTuple):
    """One diffusion of the four: those of either slope, of the map and of its error."""

    which: Array
    wanted: Array
    weight: Array
    label: Array
    start: Array
    stiffness: Array
    tolerance: Array


def diffused(
    labels: Labels,
    edges: tuple[Array, Array],
    start: Array,
    span: Array,
    params: CentreParams,
    *,
    tolerance: float,
    sloped: Array,
    last: Array,
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Diffuses labels into a map, from `start`; if `sloped`, along the slopes of `start`.

    For either slope, for the map and, at `last`, for its error, a solve each, one after the other
    by a loop: the solver compiles slowly.

    Returns:
        The map and, at `last`, the standard error of the labels that every pixel is made from, 0
        without labels; iterations and convergence of the map's own solve.
    """
    held, slopes = slope_labels(start, labels.weight, edges, steepest=_STEEPEST, flat=_FLAT)
    # What a label of this weight is known to, and at best a tenth of what counts half.
    uncertain = params.precision * jnp.sqrt(1 / jnp.clip(labels.weight, 1e-9, 0.99) - 1)
    slope, whole, nothing = params.slant, params.smoothness, jnp.zeros_like(start)
    forgotten = whole / _FORGOTTEN**2
    doubted = labels.weight + forgotten
    doubt = (labels.weight * uncertain + forgotten * spread(start, labels.weight, span)) / doubted
    solves = _Solve(
        which=jnp.arange(4),
        wanted=jnp.stack([sloped, sloped, jnp.asarray(True), last]),
        weight=jnp.concatenate([held, jnp.stack([labels.weight, doubted])]),
        label=jnp.concatenate([slopes, jnp.stack([labels.value, doubt])]),
        start=jnp.stack([nothing, nothing, start, nothing]),
        stiffness=jnp.stack([slope, slope, whole, whole]),
        tolerance=tolerance * jnp.asarray([10, 10, 1, 10], start.dtype),
    )

    def solve(found: Array, of: _Solve) -> tuple[Array, tuple[Array, Array]]:
        asked = [jnp.where(of.which == _MAP, rise, 0) for rise in rises(found[:_MAP])]
        tx, ty = (of.stiffness * t for t in edges)

        def solved() -> tuple[Array, tuple[Array, Array]]:
            system = System(of.weight, of.label, tx, ty, *asked)
            # By the estimated error, solves take up to five times the steps for the same map: most
            # of that error is in pixels without any label to speak of.
            solver = AutoSolver(tolerance=of.tolerance, by_residual=True)
            result = diffuse(system, start=of.start, solver=solver)
            return result.value, (result.stats.iterations, result.stats.converged)

        def skipped() -> tuple[Array, tuple[Array, Array]]:
            return nothing, (jnp.zeros((), jnp.int32), jnp.asarray(True))

        value, stats = lax.cond(of.wanted, solved, skipped)
        return lax.dynamic_update_index_in_dim(found, value, of.which, 0), stats

    found, (iterations, converged) = lax.scan(solve, jnp.zeros_like(solves.label), solves)
    return (found[_MAP], found[_ERROR]), (iterations[_MAP], jnp.all(converged))
