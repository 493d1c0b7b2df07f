"""Preconditioned conjugate gradients on a batch of images, each with its own stopping."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ._stencil import Coefficients, inner, largest, product, spread


class Iterate(NamedTuple):
    """What conjugate gradients found: the solution and how well it is known."""

    value: Array
    iterations: Array
    estimate: Array
    converged: Array


class _State(NamedTuple):
    probes: Array
    slowest: Array
    value: Array
    residual: Array
    direction: Array
    energy: Array
    length: Array
    longest: Array
    last: Array
    iterations: Array
    estimate: Array
    converged: Array
    active: Array


def pcg(
    coefficients: Coefficients,
    precondition: Callable[[Array], Array],
    residual: Array,
    keep: Array,
    absolute: Array,
    relative: Array,
    *,
    probes: Array,
    stop: str,
    max_iterations: int,
) -> Iterate:
    """Solves `A x = residual` from `x = 0`.

    Images of a batch share the loop but not the stopping: one that is done takes steps of length
    zero, so that it does not drift.

    Args:
        coefficients: the matrix, with any leading batch axes.
        precondition: symmetric positive definite; an approximate inverse of the matrix.
        residual: right-hand side.
        keep: pixels that take part; elsewhere the solution stays 0.
        absolute: part of the threshold for the measure of error.
        relative: part of the threshold, as a share of the largest entry of the solution.
        probes: steps that are spent on probing the preconditioner before the solve. They apply
            one minus the preconditioned matrix to waves, which leaves what the preconditioner
            misses: conjugate gradients take long to notice a region that hangs on the rest by
            edges a million times weaker than its own, as its residual is as small.
        stop: `"error"` measures the largest entry of the preconditioned residual, `"residual"`
            the root of the sum of squares of the residual.
        max_iterations: number of steps at most.

    Returns:
        The solution and its statistics.
    """
    right = residual
    lowest = 4 * jnp.finfo(right.dtype).eps

    def step(state: _State) -> _State:
        estimated_error = jnp.where(keep, precondition(state.residual), 0)
        probing = state.probes > 0
        energy = inner(state.residual, estimated_error)
        mixture = jnp.where(state.energy > 0, energy / _nonzero(state.energy), 0)
        factor = jnp.where(probing, -1, mixture)
        direction = estimated_error + spread(factor) * state.direction
        moved = product(coefficients, direction)
        curvature = inner(direction, moved)
        able = state.active & (curvature > 0) & (energy > 0) & jnp.isfinite(energy / curvature)
        able = able & ~probing
        length = jnp.where(able, energy / _nonzero(curvature), 0)
        longest, last = _longest(state, mixture, length)
        # Selected, not multiplied by zero: what cannot be used may be infinite.
        value = jnp.where(spread(able), state.value + spread(length) * direction, state.value)
        residual = state.residual - spread(length) * moved
        residual = jnp.where(spread(able), residual, state.residual)
        # What is left of the probe, next to what there was before this step.
        left = largest(direction) / _nonzero(largest(state.direction))
        slowest = jnp.where(probing, jnp.clip(1 - left, lowest, 1), state.slowest)
        last_probe = state.probes == 1
        residual = jnp.where(spread(probing), moved, residual)
        residual = jnp.where(spread(last_probe), right, residual)
        direction = jnp.where(spread(last_probe), 0, direction)
        if stop == "error":
            # The step is taken after its estimate has been made, so that the answer is better
            # than the estimate by about the factor of one iteration.
            estimate = largest(estimated_error) * jnp.maximum(longest, 1 / state.slowest)
        else:
            estimate = jnp.sqrt(inner(residual, residual))
        converged = ~probing & (estimate <= absolute + relative * largest(value))
        solving = state.active & ~probing
        return _State(
            probes=jnp.maximum(state.probes - 1, 0),
            slowest=slowest,
            value=value,
            residual=residual,
            direction=direction,
            energy=jnp.where(probing, 0, energy),
            length=length,
            longest=longest,
            last=last,
            iterations=state.iterations + solving.astype(jnp.int32),
            estimate=jnp.where(solving, estimate, state.estimate),
            converged=jnp.where(state.active, converged, state.converged),
            active=probing | (able & ~converged & (state.iterations + 1 < max_iterations)),
        )

    zero = jnp.zeros(right.shape[:-2], right.dtype)
    nothing = jnp.zeros_like(right)
    probing = spread(probes > 0)
    probe = jnp.where(keep, _probe(right), 0)
    state = _State(
        probes=probes,
        slowest=jnp.ones_like(zero),
        value=nothing,
        residual=jnp.where(probing, product(coefficients, probe), right),
        direction=jnp.where(probing, probe, 0),
        energy=zero,
        length=zero,
        longest=zero,
        last=zero,
        iterations=jnp.zeros(zero.shape, jnp.int32),
        estimate=jnp.full_like(zero, jnp.inf),
        converged=jnp.zeros(zero.shape, bool),
        active=jnp.ones(zero.shape, bool),
    )
    state = lax.while_loop(lambda state: jnp.any(state.active), step, state)
    return Iterate(state.value, state.iterations, state.estimate, state.converged)


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


def _longest(state: _State, mixture: Array, length: Array) -> tuple[Array, Array]:
    """Lower bound on the norm of the inverse of the preconditioned matrix, from CG's own numbers.

    Conjugate gradients build the Cholesky factor `R` of a tridiagonal matrix whose eigenvalues
    approach those of the preconditioned matrix: `1 / sqrt(length)` on the diagonal, and
    `sqrt(mixture / length)` above it. The squared norm of the inverse is estimated by extending
    the maximising vector by one entry per step (Duff & Vömel 2002; Meurant & Tichý 2019).
    """
    first = state.iterations == 0
    above = jnp.sqrt(mixture / _nonzero(state.length))
    corner = state.longest + length * (above * state.last) ** 2
    cross = -length * above * state.last
    middle, half = 0.5 * (corner + length), 0.5 * (corner - length)
    radius = jnp.sqrt(half**2 + cross**2)
    longest = middle + radius
    # Unit eigenvector (old, new) of [[corner, cross], [cross, length]].
    old, new = jnp.where(half > 0, half + radius, cross), jnp.where(half > 0, cross, radius - half)
    norm = _nonzero(jnp.sqrt(old**2 + new**2))
    last = (new - old * above * state.last) / norm * jnp.sqrt(length)
    moving = state.active & (length > 0)
    longest = jnp.where(first, length, longest)
    last = jnp.where(first, jnp.sqrt(length), last)
    return jnp.where(moving, longest, state.longest), jnp.where(moving, last, state.last)
