"""Diffusion of sparse labels, differentiable through the implicit function theorem."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import cast

from ._core import Options, Prepared, choose, mapped, prepare_group, solve, solve_group
from ._solver import Diffused, Solver, SolveStats
from ._stencil import Coefficients, differences, inner, largest, product, spread
from ._system import System, check, inflow


def diffuse(
    system: System, *, start: Float[Array, "y x"] | None = None, solver: Solver | None = None
) -> Diffused:
    r"""Solves a diffusion system by preconditioned conjugate gradients.

    The preconditioner is a multigrid V-cycle, or exact elimination where the image is thin.

    The gradient comes from one adjoint solve $A a = \partial L / \partial D$ that reuses the
    hierarchy: $\partial L/\partial s = w a$, $\partial L/\partial w = a (s - D)$,
    $\partial L/\partial t_{pq} = -(a_q - a_p)(D_q - D_p - r_{pq})$,
    $\partial L/\partial r_{pq} = t_{pq} (a_q - a_p)$. It is the derivative of the exact
    solution: `start`, the tolerance and the statistics have none.

    *Stopping.* The residual is a poor measure where weights differ by orders of magnitude: it
    weighs an error by the stiffness of the place. One V-cycle on the residual is an estimate of
    the error itself, in the unit of the labels, that conjugate gradients computes anyway; the
    iteration ends one step after its largest entry falls below `solver.tolerance` times the
    range of the labels. Where the preconditioner misses a mode, the estimate is too small by the
    smallest eigenvalue of the preconditioned matrix, so it is divided by what conjugate gradients
    have seen of that eigenvalue (never multiplied). Where edges differ by more than 1e5, what
    they have not seen yet is guessed from what repeated V-cycles leave of waves: a guess, no bound.
    In float32 it holds for edges from 1 to 1e-4 under data weights of 1e5; edges of 1e4 that were
    cut to 1e-5 ended at 0.7 % of the range off and passed for converged: use float64 beyond that.

    *Singular parts.* A part of the image without a path of positive edges to any data has no
    unique solution. It takes the weighted mean of all labels (0 if there is no data at all), has
    no gradient, and is counted in `stats.isolated`.

    *Batches.* Under `vmap`, large images are solved one after the other and small ones, such as
    epipolar-plane images, together; each stops on its own. A batch keeps one core of a CPU busy:
    for more, `jax.config.update("jax_num_cpu_devices", cores)` and `jax.shard_map` over the batch
    (`experiments/benchmarks/diffusion.py --only batches --devices 2`).

    *Thin images* (a side of at most 16 pixels, see `Solver`) are eliminated exactly. With
    `stop="error"` that is all: one iteration, and the estimate is a bound on the rounding that was
    measured, not computed. With a negative weight, or a tolerance below that bound (4e-6 in
    float32), what is left is substituted again.

    Args:
        system: weights and labels; `weight`, `tx`, `ty` finite and ≥ 0, labels finite where
            `weight > 0`.
        start: where to start, `[y, x]`, unit of the labels; by default the weighted mean of the
            labels. Not differentiable.
        solver: preconditioner, tolerance, cap on the iterations; by default `Solver()`.

    Returns:
        The dense map and statistics. Differentiable with respect to all maps of `system`.

    Raises:
        ValueError: shapes do not match or, outside `jit`, a weight is negative or not finite, or
            a label that counts is not finite. Under `jit` such a system gives NaN and
            `stats.converged` is False; a negative weight that leaves the matrix positive definite
            is solved.
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
    return _jitted(*arranged(system, start, solver))


def arranged(
    system: System, start: Array | None, solver: Solver | None
) -> tuple[Options, System, Array | None, Array]:
    """Checks the arguments and puts them into one precision."""
    check(system)
    solver = Solver() if solver is None else solver
    if start is not None and start.shape != system.shape:
        raise ValueError(f"`start` has the shape {start.shape}; the system has {system.shape}.")
    dtype = system.weight.dtype
    chosen = choose(solver.preconditioner, system.shape)
    options = Options(chosen, solver.stop, solver.max_iterations)
    tolerance = lax.stop_gradient(jnp.asarray(cast(solver.tolerance, dtype)))
    start = None if start is None else lax.stop_gradient(start.astype(dtype))
    return options, system, start, tolerance


@partial(jax.jit, static_argnums=0)
def _jitted(options: Options, system: System, start: Array | None, tolerance: Array) -> Diffused:
    return _diffuse(options, system, start, tolerance)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _diffuse(options: Options, system: System, start: Array | None, tolerance: Array) -> Diffused:
    return forward(options, system, start, tolerance)[0]


def forward(
    options: Options, system: System, start: Array | None, tolerance: Array
) -> tuple[Diffused, Prepared]:
    """The solution, and what its adjoint needs besides."""
    value, stats, hierarchy, keep = mapped(_forward_group, options)(system, start, tolerance)
    return Diffused(value, SolveStats(**stats)), Prepared(system.coefficients, hierarchy, keep)


def _forward_group(
    options: Options, system: System, start: Array | None, tolerance: Array
) -> tuple[Array, dict[str, Array], Any, Array]:
    """Solves for a correction of the start, so that a large common offset costs no digits.

    For one system, or for some on a leading axis: nothing but the solution is ever held for a
    whole batch.
    """
    coefficients = system.coefficients
    prepared = Prepared(coefficients, *prepare_group(options, coefficients))
    data = system.weight != 0
    label = jnp.where(data, system.label, 0)
    total = _total(system.weight)
    mean = inner(system.weight, label) / jnp.where(total > 0, total, 1)
    middle = spread(mean)
    added = inflow(system)
    right = system.weight * (label - middle) + added
    if start is None:
        base = jnp.broadcast_to(middle, label.shape)
    else:
        base = jnp.where(prepared.keep, start, middle)
        right = right - product(coefficients, base - middle)
    threshold = _threshold(options, system, label, mean, tolerance)
    found = solve_group(options, prepared, right, *threshold)
    value = jnp.where(prepared.keep, base + found.value, middle)
    sound = jnp.isfinite(total + sum(_total(maps) for maps in system.edges) + _total(right))
    value = jnp.where(spread(sound), value, jnp.nan)
    scale = jnp.sqrt(inner(system.weight * label, system.weight * label))
    rest = system.weight * (label - middle) + added - product(coefficients, value - middle)
    norm = jnp.sqrt(inner(rest, rest))
    stats = {
        "iterations": found.iterations,
        "residual": norm / jnp.where(scale > 0, scale, 1),
        "estimate": found.estimate,
        "converged": found.converged,
        "isolated": jnp.sum(~prepared.keep, axis=(-2, -1), dtype=jnp.int32),
    }
    return value, stats, prepared.hierarchy, prepared.keep


def _total(values: Array) -> Array:
    """Sum over the image."""
    return jnp.sum(values, axis=(-2, -1))


def _threshold(
    options: Options, system: System, label: Array, mean: Array, tolerance: Array
) -> tuple[Array, Array]:
    """Absolute threshold for the measure of error, with the floor of the number format."""
    precision = 4 * jnp.finfo(label.dtype).eps
    if options.stop == "residual":
        data = system.weight * label
        size = jnp.sqrt(inner(data, data))
        floor = precision * size
    else:
        known = jnp.where(system.weight > 0, label, spread(mean))
        size = jnp.max(known, axis=(-2, -1)) - jnp.min(known, axis=(-2, -1))
        floor = precision * largest(label)
    return tolerance * size + floor, jnp.zeros_like(tolerance)


def _forward(
    options: Options, system: System, start: Array | None, tolerance: Array
) -> tuple[Diffused, Any]:
    diffused, prepared = forward(options, system, start, tolerance)
    rises = system.rise_x, system.rise_y
    return diffused, (prepared, system.label, rises, diffused.value, start, tolerance)


def _backward(options: Options, residuals: Any, cotangent: Diffused) -> tuple[Any, Any, Any]:
    prepared, label, rises, value, start, tolerance = residuals
    adjoint = solve_adjoint(options, prepared, cotangent.value, tolerance)
    gradient = system_gradient(prepared.coefficients, label, value, adjoint, rises)
    nothing = None if start is None else jnp.zeros_like(start)
    return gradient, nothing, jnp.zeros_like(tolerance)


def solve_adjoint(options: Options, prepared: Prepared, right: Array, tolerance: Array) -> Array:
    """Solves with the symmetric matrix for any right-hand side, relative to the solution."""
    if options.stop == "residual":
        masked = jnp.where(prepared.keep, right, 0)
        absolute, relative = tolerance * jnp.sqrt(inner(masked, masked)), jnp.zeros_like(tolerance)
    else:
        absolute, relative = jnp.zeros_like(tolerance), tolerance
    return solve(options, prepared, right, absolute, relative).value


def system_gradient(
    coefficients: Coefficients,
    label: Array,
    value: Array,
    adjoint: Array,
    rises: tuple[Array | None, Array | None],
) -> System:
    """Gradient with respect to the four maps, given the adjoint solution."""
    adjoint_x, adjoint_y = differences(adjoint)
    value_x, value_y = differences(value)
    rise_x, rise_y = rises
    if rise_x is not None and rise_y is not None:
        value_x, value_y = value_x - rise_x, value_y - rise_y
        rise_x, rise_y = coefficients.tx * adjoint_x, coefficients.ty * adjoint_y
    return System(
        weight=adjoint * jnp.where(jnp.isfinite(label), label - value, 0),
        label=coefficients.weight * adjoint,
        tx=-adjoint_x * value_x,
        ty=-adjoint_y * value_y,
        rise_x=rise_x,
        rise_y=rise_y,
    )


_diffuse.defvjp(_forward, _backward)
