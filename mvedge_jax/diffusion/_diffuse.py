"""Diffusion of sparse labels, differentiable through the implicit function theorem."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._params import cast

from ._core import Options, Prepared, choose, prepare, solve
from ._pcg import Iterate
from ._solver import Diffused, Solver, SolveStats
from ._stencil import Coefficients, inner, largest, product, spread
from ._system import System, check, inflow


def diffuse(
    system: System, *, start: Float[Array, "y x"] | None = None, solver: Solver | None = None
) -> Diffused:
    r"""Solves a diffusion system by preconditioned conjugate gradients.

    The preconditioner is a multigrid V-cycle, or exact elimination where the image is thin.

    *Derivatives.* Forward mode solves $A \dot D = \dot w (s - D) + w \dot s - L_{\dot t} D$, plus
    the change of $\mathrm{div}(t r)$; its transpose is the adjoint solve
    $A a = \partial L / \partial D$, with $\partial L/\partial s = w a$,
    $\partial L/\partial w = a (s - D)$,
    $\partial L/\partial t_{pq} = -(a_q - a_p)(D_q - D_p - r_{pq})$ and
    $\partial L/\partial r_{pq} = t_{pq} (a_q - a_p)$. Both use the hierarchy again, and both
    may be differentiated once more. They are those of the exact solution: `start`, the tolerance
    and the statistics have none. How such a solve goes, `adjoint_solve` tells.

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
    unique solution. It takes the weighted mean of all labels (0 if there is no data at all), and
    is counted in `stats.isolated`.

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
    """Solves for a correction of the start, so that a large common offset costs no digits.

    Written around `lax.custom_linear_solve`, which is a primitive: a `custom_jvp` is forgotten
    where JAX splits a loop for reverse mode, and forward mode over that would go through the
    iterations.
    """
    # A pixel without a finite label can have no weight, and so no derivative in it either.
    finite = jnp.isfinite(system.label)
    weight = jnp.where(finite, system.weight, lax.stop_gradient(system.weight))
    coefficients = Coefficients(weight, *system.edges)
    fixed, tolerance = lax.stop_gradient((system, tolerance))
    prepared = prepare(options, fixed.coefficients)
    keep = prepared.keep
    label = jnp.where(finite | (weight != 0), system.label, 0)
    # Data on a part that has none would tie it: the mean has no derivative in its weights.
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
    threshold = _threshold(options, fixed, tolerance)

    def solve_one(_: Any, sides: tuple[Array, Array]) -> tuple[tuple[Array, Array], Any]:
        image, first = sides
        found = _linear_solve(options, prepared, image, first * threshold, (1 - first) * tolerance)
        return (found.value, first), found._replace(value=())

    right = jnp.where(keep, right, 0)

    # The second unknown equals its right-hand side: 1 in the solve for the map, which stops by the
    # range of the labels, and 0 in those for its derivatives, which stop by their own size. (JAX
    # can transpose the solve only if all of its right-hand side moves, hence the zero terms.)
    def matrix(sides: tuple[Array, Array]) -> tuple[Array, Array]:
        image = product(coefficients, sides[0])
        return image, sides[1] + 0 * image[..., 0, 0]

    (change, _), found = lax.custom_linear_solve(
        matrix,
        (right, 1 + 0 * right[..., 0, 0]),
        solve_one,
        symmetric=True,
        has_aux=True,
    )
    value = jnp.where(keep, base + change, spread(mean))
    weighted = fixed.weight * lax.stop_gradient(label)
    scale = jnp.sqrt(inner(weighted, weighted))
    rest = weight * (label - middle) + added - product(coefficients, value - middle)
    rest = lax.stop_gradient(rest)
    stats = SolveStats(
        iterations=found.iterations,
        residual=jnp.sqrt(inner(rest, rest)) / jnp.where(scale > 0, scale, 1),
        estimate=found.estimate,
        converged=found.converged,
        isolated=jnp.sum(~keep, axis=(-2, -1), dtype=jnp.int32),
    )
    return Diffused(value, lax.stop_gradient(stats))


def _total(values: Array) -> Array:
    """Sum over the image."""
    return jnp.sum(values, axis=(-2, -1))


def _threshold(options: Options, system: System, tolerance: Array) -> Array:
    """Absolute threshold for the measure of error, with the floor of the number format."""
    label = jnp.where(system.weight != 0, system.label, 0)
    precision = 4 * jnp.finfo(label.dtype).eps
    if options.stop == "residual":
        data = system.weight * label
        size = jnp.sqrt(inner(data, data))
        return tolerance * size + precision * size
    total = _total(system.weight)
    mean = inner(system.weight, label) / jnp.where(total > 0, total, 1)
    known = jnp.where(system.weight > 0, label, spread(mean))
    size = jnp.max(known, axis=(-2, -1)) - jnp.min(known, axis=(-2, -1))
    return tolerance * size + precision * largest(label)


def adjoint_solve(
    system: System, cotangent: Float[Array, "y x"], *, solver: Solver | None = None
) -> Diffused:
    r"""The solve behind the derivatives of `diffuse`, with its statistics.

    Reverse mode solves $A a = \partial L / \partial D$, forward mode the same matrix for the
    tangent. Neither can say how it went; this does, for a cotangent at hand.

    Args:
        system: as in `diffuse`; labels are not used.
        cotangent: right-hand side, `[y, x]`, of any size and unit.
        solver: as in `diffuse`. With `stop="error"` the tolerance is a share of the largest entry
            of the solution.

    Returns:
        The solution, 0 where nothing ties a pixel to data and NaN if the cotangent is not finite,
        and statistics: `residual` is relative to the cotangent.

    Raises:
        ValueError: as `diffuse`, or `cotangent` has another shape.

    Source: Thesis 6.1; the implicit function theorem.

    Example:
        >>> import jax.numpy as jnp
        >>> system = System(jnp.ones((1, 2)), jnp.zeros((1, 2)), jnp.ones((1, 1)), jnp.ones((0, 2)))
        >>> adjoint_solve(system, jnp.array([[3e-30, 0.0]])).value.tolist()
        [[2e-30, 1e-30]]
    """
    options, system, _, tolerance = arranged(system, None, solver)
    if cotangent.shape != system.shape:
        raise ValueError(
            f"`cotangent` has the shape {cotangent.shape}; the system has {system.shape}."
        )
    return _jitted_adjoint(options, system, cotangent.astype(system.weight.dtype), tolerance)


@partial(jax.jit, static_argnums=0)
def _jitted_adjoint(options: Options, system: System, right: Array, tolerance: Array) -> Diffused:
    prepared = prepare(options, system.coefficients)
    found = _linear_solve(options, prepared, right, jnp.zeros_like(tolerance), tolerance)
    right = jnp.where(prepared.keep, right, 0)
    size = _size(right)
    rest = right / size - product(system.coefficients, found.value / size)
    norms = [jnp.sqrt(inner(image, image)) for image in (rest, right / size)]
    stats = SolveStats(
        iterations=found.iterations,
        residual=norms[0] / jnp.where(norms[1] > 0, norms[1], 1),
        estimate=found.estimate,
        converged=found.converged,
        isolated=jnp.sum(~prepared.keep, dtype=jnp.int32),
    )
    return Diffused(found.value, stats)


def _size(right: Array) -> Array:
    """Largest entry per image, 1 where there is none, with axes to divide by."""
    size = spread(largest(right))
    return jnp.where(size > 0, size, 1)


def _linear_solve(
    options: Options, prepared: Prepared, right: Array, absolute: Array, relative: Array
) -> Iterate:
    """Solves for a right-hand side of any size: squares of 1e-20 are lost in float32.

    Args:
        options: static choices.
        prepared: of the matrix.
        right: right-hand side, `[y, x]`.
        absolute: part of the threshold, unit of the solution, or of `right` if `stop` says so.
        relative: part of the threshold, share of the largest entry of the solution, or of the
            norm of `right`.

    Returns:
        The solution, NaN if `right` or the matrix is not finite, and its statistics; the estimate
        is in the unit of the solution.
    """
    right = jnp.where(prepared.keep, right, 0)
    size = _size(right)
    unit, number = right / size, size[..., 0, 0]
    absolute = absolute / number
    if options.stop == "residual":
        absolute = absolute + relative * jnp.sqrt(inner(unit, unit))
        relative = jnp.zeros_like(relative)
    found = solve(options, prepared, unit, absolute, relative)
    # Sums, because maxima lose NaN on some CPUs.
    sound = jnp.isfinite(_total(right) + sum(_total(maps) for maps in prepared.coefficients))
    return found._replace(
        value=jnp.where(spread(sound), found.value * size, jnp.nan),
        estimate=found.estimate * number,
        converged=found.converged & sound,
    )
