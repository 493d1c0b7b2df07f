"""Preconditioned conjugate gradients on a batch of images, each with its own stopping.

One V-cycle on the residual, which conjugate gradients compute anyway, estimates the error. The
estimate is divided by the smallest eigenvalue of the preconditioned matrix, see `_longest`. But a
preconditioner may miss a mode: a region whose edges to the rest are a billion times weaker than
its own has a tiny residual, however wrong its level is, and conjugate gradients need many steps to
notice. No quantity computed from the residual shows this error. If edges are that uneven, a
*companion* system is therefore solved with the same matrix and a right-hand side whose solution is
known. Both share the steps of conjugate gradients, so the same polynomial of the matrix multiplies
both errors, and that of the companion can be measured. The solution of the companion is a
constant, which meets the data like the solve itself, plus the remainder of waves after repeated
preconditioning: exactly the missed modes. Rounding errors show in the companion, too, but
unreliably if they are nearly all of the error; a bound by the norm of the inverse, which conjugate
gradients estimate, excludes that case.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ._stencil import Coefficients, inner, largest, product, spread

# The numbers of the stopping rule come from arithmetic and tests on many systems, not from scenes.
# Steps that prepare the companion, and the share of its error to that of the solve.
_PROBES, _SAFETY = 4, 3.0
# The number format's precision times the norm of the inverse bounds what rounding does to the
# solution. Of that bound, errors were seen to be a hundredth to twice, and where they could be
# told from the companion it was below ten thresholds; above sixty the two have nothing in common.
_ROUNDED = 1 / 60
# Edges are uneven if the largest is more than this times the smallest; below, multigrid missed no
# mode in tests.
_EVEN = 1e3


class Iterate(NamedTuple):
    """Result of conjugate gradients: the solution and its error estimate."""

    value: Array
    iterations: Array
    estimate: Array
    converged: Array


class _Problem(NamedTuple):
    """The constants of an iteration."""

    coefficients: Coefficients
    precondition: Callable[[Array], Array]
    keep: Array
    doubtful: Array
    absolute: Array
    relative: Array
    by_residual: bool
    max_iterations: int


class _State(NamedTuple):
    """The first axis of images is for the solve itself and its companion.

    The value of the companion is its error: it starts at minus its solution.
    """

    probes: Array
    value: Array
    residual: Array
    z: Array  # guess of the error, the preconditioned residual
    direction: Array
    Ap: Array  # the matrix times the direction
    scale: Array
    rz: Array  # inner product of residual and guess
    alpha: Array  # length of the step
    longest: Array
    last: Array
    iterations: Array
    estimate: Array
    converged: Array
    active: Array


def pcg(
    coefficients: Coefficients,
    precondition: Callable[[Array], Array],
    right: Array,
    keep: Array,
    absolute: Array,
    relative: Array,
    *,
    by_residual: bool,
    max_iterations: int,
) -> Iterate:
    """Solves `A x = right` from `x = 0`.

    Images of a batch share the loop but not the stopping: one that is done takes steps of length
    zero, so that it does not drift.

    Args:
        coefficients: the matrix, with any leading batch axes.
        precondition: symmetric positive definite; an approximate inverse of the matrix.
        right: right-hand side.
        keep: pixels that take part; elsewhere the solution stays 0.
        absolute: part of the threshold for the measure of error.
        relative: part of the threshold, as a share of the largest entry of the solution.
        by_residual: measure the root of the sum of squares of the residual, not the error.
        max_iterations: number of steps at most.

    Returns:
        The solution and its statistics.
    """
    zero = jnp.zeros(right.shape[:-2], right.dtype)
    doubtful = jnp.zeros(zero.shape, bool) if by_residual else _uneven(coefficients)
    problem = _Problem(
        coefficients, precondition, keep, doubtful, absolute, relative, by_residual, max_iterations
    )
    nothing = jnp.zeros((2, *right.shape), right.dtype)
    wave = jnp.where(keep & spread(doubtful), _probe(right), 0)
    state = _State(
        probes=jnp.where(jnp.any(doubtful), _PROBES, 0),
        value=nothing,
        residual=jnp.stack([right, product(coefficients, wave)]),
        z=nothing,
        direction=jnp.stack([nothing[0], wave]),
        Ap=nothing,
        scale=zero,
        rz=zero,
        alpha=zero,
        longest=zero,
        last=zero,
        iterations=jnp.zeros(zero.shape, jnp.int32),
        estimate=jnp.full_like(zero, jnp.inf),
        converged=jnp.zeros(zero.shape, bool),
        active=jnp.ones(zero.shape, bool),
    )

    def step(state: _State) -> _State:
        return _step(problem, state)

    state = lax.while_loop(lambda state: jnp.any(state.active), step, state)
    return Iterate(state.value[0], state.iterations, state.estimate, state.converged)


def _step(problem: _Problem, state: _State) -> _State:
    """One step of conjugate gradients, or one that prepares the companion."""
    probing = state.probes > 0
    new, errors, beta, curvature = _directed(problem, state)
    rz = new.rz
    able = state.active & (curvature > 0) & (rz > 0) & jnp.isfinite(rz / curvature)
    able = able & ~probing
    alpha = jnp.where(able, rz / _nonzero(curvature), 0)
    longest, last = _longest(state, beta, alpha)

    def walk(i: Array, carry: tuple[Any, Array]) -> tuple[Any, Array]:
        images, sizes = carry
        # Selected, not multiplied by zero, because unused values may be infinite.
        steps = (spread(alpha) * new.direction[i], -spread(alpha) * new.Ap[i])
        walked = [
            jnp.where(spread(able), a[i] + b, a[i]) for a, b in zip(images, steps, strict=True)
        ]
        return _each(images, i, walked), sizes.at[i].set(largest(walked[0]))

    (value, residual), (size, wrong) = lax.fori_loop(
        *_members(problem, state),
        walk,
        ((state.value, state.residual), jnp.zeros_like(errors)),
    )
    new = new._replace(value=value, residual=residual)
    new = lax.cond(jnp.any(probing), lambda: _accompanied(problem, new, errors[0]), lambda: new)
    if problem.by_residual:
        estimate = jnp.sqrt(inner(residual[0], residual[0]))
    else:
        # The step follows its estimate, so that the solution is better than the estimate by about
        # the factor of one iteration.
        known = wrong * jnp.maximum(size / _nonzero(new.scale), 1)
        estimate = errors[0] * longest
        rounded = _ROUNDED * jnp.finfo(size.dtype).eps * longest * size
        seen = jnp.maximum(_SAFETY * known, rounded)
        estimate = jnp.where(problem.doubtful, jnp.maximum(estimate, seen), estimate)
    threshold = problem.absolute + problem.relative * size
    converged = ~probing & (estimate <= threshold)
    solving = state.active & ~probing
    # Updated residuals keep falling when the values have converged to rounding.
    own = jnp.max(errors, axis=0) * longest
    lost = problem.doubtful & (own <= jnp.finfo(own.dtype).eps * threshold)
    more = able & ~converged & ~lost & (state.iterations + 1 < problem.max_iterations)
    return new._replace(
        probes=jnp.maximum(state.probes - 1, 0),
        rz=jnp.where(probing, 0, rz),
        alpha=alpha,
        longest=longest,
        last=last,
        iterations=state.iterations + solving.astype(jnp.int32),
        estimate=jnp.where(solving, estimate, state.estimate),
        converged=jnp.where(state.active, converged, state.converged),
        active=jnp.where(probing, state.active, more),
    )


def _members(problem: _Problem, state: _State) -> tuple[Array, Array]:
    """Range of images to iterate: without the companion if edges are even."""
    first = jnp.where(state.probes > 1, 1, 0)
    return first, jnp.where(jnp.any(problem.doubtful), 2, 1)


def _directed(problem: _Problem, state: _State) -> tuple[_State, Array, Array, Array]:
    """Preconditions the residuals and makes directions of them.

    Returns:
        The state with `z`, directions, `Ap` and `rz`; the largest entries of both guesses; the
        share beta of the last direction in the new one; the curvature.
    """
    members, zero = _members(problem, state), jnp.zeros_like(state.rz)

    def guessed(i: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        z, errors, rz = carry
        own = jnp.where(problem.keep, problem.precondition(state.residual[i]), 0)
        rz = rz + inner(state.residual[i], own)
        return z.at[i].set(own), errors.at[i].set(largest(own)), rz

    z, errors, rz = lax.fori_loop(*members, guessed, (state.z, jnp.stack([zero, zero]), zero))
    beta = jnp.where(state.rz > 0, rz / _nonzero(state.rz), 0)
    # A probe applies one minus the preconditioned matrix, which leaves what is missed.
    factor = jnp.where(state.probes > 0, -1, beta)

    def turned(i: Array, direction: Array) -> Array:
        # Without a share of the last direction, it may be infinite.
        before = jnp.where(spread(factor) == 0, 0, spread(factor) * direction[i])
        return direction.at[i].set(z[i] + before)

    # A separate loop, because a direction that is not stored is recomputed by each reader.
    direction = lax.fori_loop(*members, turned, state.direction)

    def multiplied(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        Ap, curvature = carry
        image = product(problem.coefficients, direction[i])
        return Ap.at[i].set(image), curvature + inner(direction[i], image)

    Ap, curvature = lax.fori_loop(*members, multiplied, (state.Ap, zero))
    new = state._replace(z=z, direction=direction, Ap=Ap, rz=rz)
    return new, errors, beta, curvature


def _accompanied(problem: _Problem, state: _State, first: Array) -> _State:
    """While probing, the next probe; after the last one, the start of the companion."""
    last = state.probes == 1
    # As large as the solution: the first guess of it.
    scale = jnp.where(last, first, state.scale)
    share = jnp.where(problem.doubtful, scale / _nonzero(largest(state.direction[1])), 0)
    share = spread(jnp.where(last, share, 1))
    constant = jnp.where(problem.keep & spread(problem.doubtful & last), spread(scale), 0)
    residual = share * state.Ap[1] + problem.coefficients.weight * constant
    value = jnp.where(last, -share * state.direction[1] - constant, state.value[1])
    return state._replace(
        scale=scale,
        residual=state.residual.at[1].set(residual),
        value=state.value.at[1].set(value),
    )


def _each(images: tuple[Array, ...], i: Array, values: list[Array]) -> Any:
    """Puts every value into its stack of images."""
    return tuple(stack.at[i].set(value) for stack, value in zip(images, values, strict=True))


def _uneven(coefficients: Coefficients) -> Array:
    """Whether edges are so uneven that multigrid may miss a mode."""
    _, tx, ty = coefficients
    strong = jnp.maximum(largest(tx), largest(ty))
    return strong > _EVEN * jnp.minimum(_least(tx), _least(ty))


def _least(edges: Array) -> Array:
    """Smallest edge weight that is not zero, per image of a batch."""
    return jnp.min(jnp.where(edges > 0, edges, jnp.inf), axis=(-2, -1), initial=jnp.inf)


def _probe(like: Array) -> Array:
    """Waves of several lengths on 1: different in every region, smooth inside.

    Noise would do too, but float32 loses what it leaves behind to the rounding of its residual.
    """
    y, x = like.shape[-2:]
    total = jnp.ones((y, x), like.dtype)
    for along_y, along_x in ((19.0, 17.0), (71.0, 29.0), (37.0, 113.0), (151.0, 211.0)):
        rows = np.sin(2 * np.pi / along_y * np.arange(y) + 1)
        columns = np.sin(2 * np.pi / along_x * np.arange(x) + 2)
        waves = jnp.asarray(rows, like.dtype)[:, None] * jnp.asarray(columns, like.dtype)[None]
        total = total + 0.7 * waves
    return jnp.broadcast_to(total, like.shape)


def _nonzero(value: Array) -> Array:
    return jnp.where(value > 0, value, jnp.ones_like(value))


def _longest(state: _State, beta: Array, alpha: Array) -> tuple[Array, Array]:
    """Lower bound on the norm of the inverse of the preconditioned matrix, from CG's own numbers.

    Conjugate gradients build the Cholesky factor `R` of a tridiagonal matrix whose eigenvalues
    approach those of the preconditioned matrix: `1 / sqrt(alpha)` on the diagonal, and
    `sqrt(beta / alpha)` above it. The squared norm of the inverse is estimated by extending
    the maximizing vector by one entry per step (Duff & Vömel 2002; Meurant & Tichý 2019).
    """
    first = state.iterations == 0
    above = jnp.sqrt(beta / _nonzero(state.alpha))
    corner = state.longest + alpha * (above * state.last) ** 2
    cross = -alpha * above * state.last
    middle, half = 0.5 * (corner + alpha), 0.5 * (corner - alpha)
    radius = jnp.sqrt(half**2 + cross**2)
    longest = middle + radius
    # Unit eigenvector (old, new) of [[corner, cross], [cross, alpha]].
    old, new = jnp.where(half > 0, half + radius, cross), jnp.where(half > 0, cross, radius - half)
    norm = _nonzero(jnp.sqrt(old**2 + new**2))
    last = (new - old * above * state.last) / norm * jnp.sqrt(alpha)
    moving = state.active & (alpha > 0)
    longest = jnp.where(first, alpha, longest)
    last = jnp.where(first, jnp.sqrt(alpha), last)
    return jnp.where(moving, longest, state.longest), jnp.where(moving, last, state.last)
