"""Diffusion of sparse labels, differentiable through the implicit function theorem."""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy, cast

from ._linear import linear_operator
from ._pcg import Iterate
from ._solver import AbstractSolver, Diffused, SolveStats, choices, solve
from ._solvers import AutoSolver
from ._stencil import Coefficients, inner, largest, product, reachable, spread
from ._system import System, check, inflow


@accepts_numpy
def diffuse(
    system: System,
    *,
    start: Float[Array, "y x"] | None = None,
    solver: lx.AbstractLinearSolver | None = None,
    adjoint: lx.AbstractLinearSolver | None = None,
) -> Diffused:
    r"""Solves a diffusion system: dense maps from sparse labels.

    *Derivatives.* Forward mode solves $A \dot D = \dot w (s - D) + w \dot s - L_{\dot t} D$, plus
    the change of $\mathrm{div}(t r)$; its transpose is the adjoint solve
    $A a = \partial L / \partial D$, with $\partial L/\partial s = w a$,
    $\partial L/\partial w = a (s - D)$,
    $\partial L/\partial t_{pq} = -(a_q - a_p)(D_q - D_p - r_{pq})$ and
    $\partial L/\partial r_{pq} = t_{pq} (a_q - a_p)$. Both use the hierarchy again, and both
    may be differentiated once more. Derivatives are those of the exact solution: `start`, the
    tolerance and the statistics have none. For the statistics of such a solve, call Lineax with
    the cotangent:
    `lineax.linear_solve(linear_operator(system), cotangent, Multigrid())`.

    *Stopping.* The solver estimates the largest error of the map, in the unit of the labels, and
    stops one step after it falls below the tolerance times the range of the labels. The residual
    would be a poor measure, because it scales an error by the local stiffness. Where float32 cannot
    solve the system, with edges cut by 1e-6 or more, `converged` is False
    (`experiments/solver_truth.py`).

    *Singular parts.* A part of the image without a path of positive edges to any data has no
    unique solution. It takes the weighted mean of all labels, or 0; `stats.isolated` counts it.

    *Batches.* Under `vmap`, large images are solved one after the other and small ones, such as
    epipolar-plane images, together; each stops on its own. A batch keeps one core busy; for more,
    `jax.config.update("jax_num_cpu_devices", cores)` and `jax.shard_map` over the batch
    (`experiments/benchmarks/diffusion.py --only batches --devices 2`).

    Args:
        system: weights and labels; `weight`, `tx`, `ty` finite and ≥ 0, labels finite where
            `weight > 0`.
        start: initial value, `[y, x]`, unit of the labels; by default the weighted mean of the
            labels. Not differentiable.
        solver: `AutoSolver`, the default, `Multigrid`, `Elimination` or a `ConjugateGradients` of
            your own, with tolerance and cap on the iterations; or any solver of Lineax for
            symmetric operators, with its own measure of convergence.
        adjoint: solver of the derivatives in either mode; by default `solver`. It shares the
            compiled program if only the tolerance differs.

    Returns:
        The dense map and statistics. Differentiable with respect to all maps of `system`.

    Raises:
        ValueError: shapes do not match or, outside `jit`, a weight is negative or not finite, or
            a label that counts is not finite, or a tolerance is negative or NaN. Under `jit` such
            a system gives NaN, and `stats.converged` is False, as for such a tolerance. A system
            with a negative weight is solved if its matrix is positive definite.
        TypeError: the maps are not of one floating type.

    Source: Thesis 6.1, Eq. 6.1; 7.1.1, Eq. 7.2.

    Example:
        >>> import jax.numpy as jnp
        >>> weight = jnp.array([[1e3, 0.0, 0.0, 1e3]])
        >>> label = jnp.array([[0.0, 0.0, 0.0, 3.0]])
        >>> system = System(weight, label, jnp.ones((1, 3)), jnp.ones((0, 4)))
        >>> diffuse(system).value.round(2).tolist()
        [[0.0, 1.0, 2.0, 3.0]]
    """
    check(system)
    for name, given in (("solver", solver), ("adjoint", adjoint)):
        _check_tolerance(name, given)
    if start is not None and start.shape != system.shape:
        raise ValueError(f"`start` has the shape {start.shape}; the system has {system.shape}.")
    dtype = system.weight.dtype
    solver = AutoSolver() if solver is None else solver
    numbers, static = eqx.partition(cast((solver, adjoint), dtype), eqx.is_array)
    start = None if start is None else lax.stop_gradient(start.astype(dtype))
    return _jitted(static, lax.stop_gradient(numbers), system, start)


@partial(jax.jit, static_argnums=0)
def _jitted(static: Any, numbers: Any, system: System, start: Array | None) -> Diffused:
    """Solves for a correction of the start, so that a large common offset costs no digits.

    It uses the primitive `lax.custom_linear_solve`, because JAX drops a `custom_jvp` when it
    splits a loop for reverse mode; forward mode over that would differentiate the iterations.
    """
    # A pixel without a finite label has weight 0, so the derivative in the weight is 0, too.
    finite = jnp.isfinite(system.label)
    weight = jnp.where(finite, system.weight, lax.stop_gradient(system.weight))
    coefficients = Coefficients(weight, *system.edges)
    fixed = lax.stop_gradient(system)
    both = eqx.combine(numbers, static)
    solve_one, keep, threshold = _solvers(both, fixed)
    label = jnp.where(finite | (weight != 0), system.label, 0)
    # A part without data gets the mean, which has no derivative in the weights of this part.
    known = jnp.where(keep, weight, 0)
    total = _total(known)
    mean = inner(known, label) / jnp.where(total > 0, total, 1)
    middle = spread(lax.stop_gradient(mean))
    added = inflow(system)
    right = weight * (label - middle) + added
    if start is None:
        base = jnp.broadcast_to(middle, label.shape)
    else:
        base = jnp.where(keep, start, middle)
        right = right - product(coefficients, base - middle)
    right = jnp.where(keep, right, 0)

    # The second unknown equals its right-hand side: 1 in the solve for the map, which stops by the
    # range of the labels, and 0 in those for its derivatives, which stop by their own size. (JAX
    # can transpose the solve only if all of its right-hand side moves, and differentiate what it
    # has transposed only if all of its solution is used, hence the zero terms.)
    def matrix(sides: tuple[Array, Array]) -> tuple[Array, Array]:
        image = product(coefficients, sides[0])
        return image, sides[1] + 0 * image[..., 0, 0]

    (change, first), solved = lax.custom_linear_solve(
        matrix,
        (right, 1 + 0 * right[..., 0, 0]),
        solve_one,
        symmetric=True,
        has_aux=True,
    )
    value = jnp.where(keep, base + (change + 0 * spread(first)), spread(mean))
    weighted = fixed.weight * lax.stop_gradient(label)
    scale = jnp.sqrt(inner(weighted, weighted))
    rest = weight * (label - middle) + added - product(coefficients, value - middle)
    rest = lax.stop_gradient(jnp.sqrt(inner(rest, rest)))
    converged = solved.converged
    if getattr(both[0], "by_residual", False):
        # The residual that conjugate gradients update drifts from the true one.
        converged = converged & (rest <= 3 * threshold)
    if isinstance(both[0], AbstractSolver):
        converged = converged & (both[0].tolerance >= 0)
    stats = SolveStats(
        iterations=solved.iterations,
        residual=rest / jnp.where(scale > 0, scale, 1),
        estimate=solved.estimate,
        converged=converged,
        isolated=jnp.sum(~keep, axis=(-2, -1), dtype=jnp.int32),
    )
    return Diffused(value, lax.stop_gradient(stats))


def _solvers(both: Any, system: System) -> tuple[Callable[..., Any], Array, Array]:
    """The solve for the map and for its derivatives as one function.

    Returns:
        The function, the pixels that are tied to data and the threshold of the map's solve.
    """
    solver, adjoint = both
    operator = linear_operator(system)
    state = solver.init(operator, {})
    ours = isinstance(solver, AbstractSolver)
    keep = state.keep if ours else reachable(system.coefficients)
    threshold = _threshold(solver, system) if ours else jnp.asarray(jnp.nan, system.weight.dtype)
    # The thresholds are traced: one program serves both.
    shared = ours and isinstance(adjoint, AbstractSolver) and choices(solver) == choices(adjoint)
    if adjoint is None or shared:
        other = adjoint or solver

        def corrected(image: Array, first: Array) -> Iterate:
            return _solved(solver, state, image, first * threshold, (1 - first), other)
    else:
        prepared = adjoint.init(operator, {})

        def corrected(image: Array, first: Array) -> Iterate:
            return lax.cond(
                first != 0,
                lambda: _solved(solver, state, image, threshold, 1 - first, solver),
                lambda: _solved(adjoint, prepared, image, 0 * threshold, 1 - first, adjoint),
            )

    def solve_one(_: Any, sides: tuple[Array, Array]) -> tuple[tuple[Array, Array], Any]:
        iterate = corrected(jnp.where(keep, sides[0], 0), sides[1])
        return (iterate.value, sides[1]), iterate._replace(value=())

    return solve_one, keep, threshold


def _solved(
    solver: lx.AbstractLinearSolver,
    state: Any,
    right: Array,
    absolute: Array,
    share: Array,
    promise: lx.AbstractLinearSolver,
) -> Iterate:
    """Solves with a solver of this package, or with another one and its own tolerance."""
    if isinstance(solver, AbstractSolver) and isinstance(promise, AbstractSolver):
        return solve(solver, state, right, absolute, share * promise.tolerance)
    value, result, stats = solver.compute(state, right, {})
    return Iterate(
        value,
        jnp.asarray(stats.get("num_steps", 1), jnp.int32),
        jnp.full((), jnp.nan, right.dtype),
        result == lx.RESULTS.successful,
    )


def _check_tolerance(name: str, solver: lx.AbstractLinearSolver | None) -> None:
    tolerance = solver.tolerance if isinstance(solver, AbstractSolver) else 0.0
    if isinstance(tolerance, Tracer):
        return
    values = np.asarray(tolerance)
    if not (values >= 0).all():
        raise ValueError(
            f"`{name}.tolerance` must not be negative or NaN, got {values[~(values >= 0)].flat[0]}."
        )


def _total(values: Array) -> Array:
    """Sum over the image."""
    return jnp.sum(values, axis=(-2, -1))


def _threshold(solver: AbstractSolver, system: System) -> Array:
    """Absolute threshold for the measure of error, with the floor of the number format."""
    label = jnp.where(system.weight != 0, system.label, 0)
    tolerance, precision = solver.tolerance, 4 * jnp.finfo(label.dtype).eps
    if solver.by_residual:
        data = system.weight * label
        size = jnp.sqrt(inner(data, data))
        return tolerance * size + precision * size
    total = _total(system.weight)
    mean = inner(system.weight, label) / jnp.where(total > 0, total, 1)
    known = jnp.where(system.weight > 0, label, spread(mean))
    size = jnp.max(known, axis=(-2, -1)) - jnp.min(known, axis=(-2, -1))
    return tolerance * size + precision * largest(label)
