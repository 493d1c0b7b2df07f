"""Exact elimination for thin images, such as epipolar-plane images, many at once.

The short side is eliminated as a whole, column after column. Multigrid coarsens the short side of
such an image away after a few levels and needs two to five times the iterations that it needs on a
square; this costs as much as about two of them, at any contrast.

Three habits of XLA on the CPU shape the code, each worth a factor of two to ten here. It computes
a product anew for every reader, but never a division, so that what is read often is the result of
one. A sum along a short axis is a call to a library; the same sum, written out, is not. A slice of
many rows of a large array is copied element by element, so that the factors are many small arrays.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ._pcg import Iterate
from ._stencil import Coefficients, inner, largest, pad, product, spread

# Error of the elimination, in roundings of the largest entry: twice the largest that was seen, on
# sides from 1 to 16, up to 2000 pixels long, data at 1 to 90 % of them, and any contrast.
_ROUNDING = 32
# Columns of an upper triangular U, `h` times `[h, b]`; what is below the diagonal has no meaning.
Factors = tuple[Array, ...]


class _Front(NamedTuple):
    """The last column that was eliminated."""

    factors: Factors  # of the inverse of its matrix, U U^T
    sums: Array  # its row sums and its right-hand side, `[h, 2, b]`
    tie: Array  # to the next column, `[h, b]`


class _State(NamedTuple):
    value: Array
    residual: Array
    iterations: Array
    estimate: Array
    converged: Array
    active: Array


def refine(
    coefficients: Coefficients,
    right: Array,
    keep: Array,
    absolute: Array,
    relative: Array,
    *,
    stop: str,
    max_iterations: int,
) -> Iterate:
    """Eliminates, and does so again with what is left while that is asked for and helps.

    Once is enough for an error above the rounding. With a negative weight digits may be lost, so
    that the first estimate is the solution itself; each later one is the last correction.

    Args:
        coefficients: the matrix, with any leading batch axes.
        right: right-hand side.
        keep: pixels that take part; elsewhere the solution stays 0.
        absolute: part of the threshold for the measure of error.
        relative: part of the threshold, as a share of the largest entry of the solution.
        stop: `"error"` or `"residual"`, the root of the sum of squares of the residual.
        max_iterations: eliminations at most.

    Returns:
        The solution and its statistics.
    """
    rounding = _ROUNDING * jnp.finfo(right.dtype).eps
    positive = jnp.all(coefficients.weight >= 0, axis=(-2, -1))

    def step(state: _State) -> _State:
        change = jnp.where(keep & spread(state.active), solve(coefficients, state.residual), 0)
        value = state.value + change
        size = largest(value)

        def left() -> Array:
            return state.residual - product(coefficients, change)

        if stop == "error":
            first = positive & (state.iterations == 0)
            estimate = jnp.where(first, rounding * size, largest(change))
            residual = None
        else:
            residual = left()
            estimate = jnp.sqrt(inner(residual, residual))
        converged = estimate <= absolute + relative * size
        helps = estimate < 0.5 * state.estimate
        more = state.active & helps & ~converged & (state.iterations + 1 < max_iterations)
        if residual is None:
            residual = lax.cond(jnp.any(more), left, lambda: state.residual)
        return _State(
            value,
            residual,
            state.iterations + state.active.astype(jnp.int32),
            jnp.where(state.active, estimate, state.estimate),
            jnp.where(state.active, converged, state.converged),
            more,
        )

    nothing = jnp.zeros(right.shape[:-2], right.dtype)
    state = _State(
        jnp.zeros_like(right),
        right,
        jnp.zeros(nothing.shape, jnp.int32),
        jnp.full_like(nothing, jnp.inf),
        jnp.zeros(nothing.shape, bool),
        jnp.ones(nothing.shape, bool),
    )
    state = lax.while_loop(lambda state: jnp.any(state.active), step, state)
    return Iterate(state.value, state.iterations, state.estimate, state.converged)


def solve(coefficients: Coefficients, right: Array) -> Array:
    r"""Eliminates column after column, and substitutes backwards.

    With G the inverse of the last column's matrix and t its ties to the next column, that one has
    the ties :math:`t_i G_{ij} t_j` in addition, the row sums :math:`w + t\,G e`, where e are the
    last one's, and the right-hand side :math:`b + t\,G b'`. Keeping the row sums in place of the
    diagonal leaves nothing to subtract, so that no digit is lost at any contrast (Grassmann,
    Taksar & Heyman 1985): the error is the rounding of the largest label.

    Args:
        coefficients: the matrix, with any leading batch axes.
        right: right-hand side.

    Returns:
        The solution; zero where nothing is tied to data.
    """
    y, x = right.shape[-2:]
    tx, ty = pad(coefficients.tx, (0, 0), (0, 1)), pad(coefficients.ty, (0, 1), (0, 0))
    along, across = (tx, ty) if y <= x else (ty, tx)
    weight, ahead, within, data = (
        _in_order(images) for images in (coefficients.weight, along, across, right)
    )

    def forward(front: _Front, column: tuple[Array, Array, Array, Array]) -> tuple[_Front, Any]:
        weight, ahead, within, data = column
        passed = _inverse(front.factors, front.sums)
        sums = jnp.stack([weight, data], 1) + front.tie[:, None] * passed
        factors = _invert(front.factors, front.tie, within, sums[:, 0] + ahead)
        return _Front(factors, sums, ahead), (factors, sums[:, 1])

    def backward(later: Array, column: tuple[Factors, Array, Array]) -> tuple[Array, Array]:
        factors, data, ahead = column
        value = _inverse(factors, _kept(data + ahead * later)[:, None])[:, 0]
        return value, value

    nothing = jnp.zeros_like(data[0])
    front = _Front((nothing,) * min(y, x), jnp.stack([nothing, nothing], 1), nothing)
    factors, own = lax.scan(forward, front, (weight, ahead, within, data))[1]
    value = lax.scan(backward, nothing, (factors, own, ahead), reverse=True)[1]
    return _as_images(value, right.shape)


def _invert(before: Factors, tie: Array, within: Array, mass: Array) -> Factors:
    """Factors of the inverse of a column's matrix: a symmetric Gauss-Jordan elimination.

    Args:
        before: factors of the column before.
        tie: to that column.
        within: ties between neighbours in the column.
        mass: row sums.

    Returns:
        The columns of U; zero where a pixel is tied to nothing.
    """
    h = len(before)
    at = np.arange(h)
    found: list[Array] = []
    excess: list[Array] = []
    for k in range(h):
        later = range(k + 1, h)
        ties = [
            _sum(before[j][i] * before[j][k] for j in range(i, h)) * (tie[i] * tie[k])
            + _sum(done[i] * done[k] for done in found)
            for i in later
        ]
        own = mass[k] + _sum(done[k] * part for done, part in zip(found, excess, strict=True))
        pivot = own + _sum(ties) + (within[k] if later else 0)
        alive = pivot > 0
        root = jnp.sqrt(jnp.where(alive, pivot, 1))
        row = _sum(_rows((at > k) & (at <= j), tie) * before[j] * before[j][k][None] for j in later)
        row = row * tie * tie[k][None] + _rows(at == k + 1, tie) * within[k][None]
        row = row + _sum(
            _rows((at <= j) | (at > k), tie) * done * done[k][None] for j, done in enumerate(found)
        )
        diagonal = _rows(at == k, tie)
        # Two halves on the diagonal: by a divisor that is the same in all rows, XLA would multiply.
        found.append(
            (row + jnp.where(alive[None], 2 * diagonal, 0)) / (root[None] * (1 + diagonal))
        )
        excess.append(own / root)
    return tuple(found)


def _inverse(factors: Factors, values: Array) -> Array:
    """`U U^T values` of a column, `[h, k, b]`."""
    at = np.arange(len(factors))
    parts = [_sum(one[i][None] * values[i] for i in range(j + 1)) for j, one in enumerate(factors)]
    return _sum(
        (_rows(at <= j, values) * one)[:, None] * _kept(part)[None]
        for j, (one, part) in enumerate(zip(factors, parts, strict=True))
    )


def _sum(terms: Iterable[Array]) -> Any:
    """Sum of the terms, written out; 0 if there are none."""
    total: Any = 0
    for term in terms:
        total = total + term
    return total


def _kept(values: Array) -> Array:
    """The values, as the result of a division by a one that the compiler does not see."""
    return values / jnp.where(jnp.isinf(values), values, 1)


def _rows(chosen: np.ndarray, like: Array) -> Array:
    """One in the chosen rows, zero elsewhere, `[h, 1]`."""
    return jnp.asarray(chosen[:, None], like.dtype)


def _in_order(images: Array) -> Array:
    """From images to columns in the order of elimination, batch last."""
    y, x = images.shape[-2:]
    return jnp.transpose(images.reshape(-1, y, x), (2, 1, 0) if y <= x else (1, 2, 0))


def _as_images(columns: Array, shape: tuple[int, ...]) -> Array:
    """The inverse of `_in_order`."""
    return jnp.transpose(columns, (2, 1, 0) if shape[-2] <= shape[-1] else (2, 0, 1)).reshape(shape)
