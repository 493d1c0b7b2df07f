"""Exact elimination for thin images, such as epipolar-plane images, many at once.

The short side is eliminated as a whole, column after column. Multigrid coarsens the short side of
such an image away after a few levels and needs two to five times the iterations that it needs on a
square. For 64 images 512 long, elimination takes a ninth of its time with 9 rows, a third with 16
and as long with 24, at any contrast.

Four properties of XLA on the CPU shape the code, each worth a factor of 1.2 to ten here. A product
is recomputed for every reader: a pixel is therefore eliminated behind a fence, and values that are
read often are results of a division, which is not repeated. A sum along a short axis is a library
call, unless it is written out. A slice of a large array is copied element by element unless it is
a row. Every output of a scan starts as a copy of zeros, so one large array is better than many.
"""

from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from mvedge_jax._cpu import no_fuse

from ._pcg import Iterate
from ._stencil import Coefficients, inner, largest, pad, product, spread

# Error bound of the elimination, in roundings of the largest entry: twice the largest error
# measured, on sides from 1 to 16, up to 2000 pixels long, data at 1 to 90 % of them, any contrast.
_ROUNDING = 32


class _Front(NamedTuple):
    """The last column that was eliminated."""

    tableau: Array  # swept: its inverse, and the inverse times its row sums and right-hand side
    tie: Array  # to the next column, `[h, b]`


class _Eliminated(NamedTuple):
    """A matrix as a chain of columns, `w` of them."""

    inverses: Array  # of each column's matrix after the elimination of those before, `[w, h, h, b]`
    ahead: Array  # ties to the next column, `[w, h, b]`


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
    by_residual: bool,
    max_iterations: int,
) -> Iterate:
    """Eliminates, and repeats the substitution with the residual while it is needed and helps.

    One substitution suffices for a threshold above the rounding error. A negative weight may lose
    digits, so the first estimate of the error is the solution itself, and later ones are the last
    correction. Arguments are those of `pcg`.
    """
    rounding = _ROUNDING * jnp.finfo(right.dtype).eps
    positive = jnp.all(coefficients.weight >= 0, axis=(-2, -1))

    def add(state: _State, change: Array) -> _State:
        change = jnp.where(keep & spread(state.active), change, 0)
        value = state.value + change
        size = largest(value)

        def left() -> Array:
            return state.residual - product(coefficients, change)

        if by_residual:
            residual = left()
            estimate = jnp.sqrt(inner(residual, residual))
        else:
            first = positive & (state.iterations == 0)
            estimate = jnp.where(first, rounding * size, largest(change))
            residual = None
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
    eliminated, carried = _eliminate(coefficients, right)
    state = add(state, _as_images(_backwards(eliminated, carried), right.shape))

    def again(state: _State) -> _State:
        carried = _forwards(eliminated, _in_order(state.residual))
        return add(state, _as_images(_backwards(eliminated, carried), right.shape))

    state = lax.while_loop(lambda state: jnp.any(state.active), again, state)
    return Iterate(state.value, state.iterations, state.estimate, state.converged)


def _eliminate(coefficients: Coefficients, right: Array) -> tuple[_Eliminated, Array]:
    r"""Eliminates column after column, and the right-hand side as `_forwards` does.

    With G the inverse of the last column's matrix and t its ties to the next column, that one has
    the ties $t_i G_{ij} t_j$ in addition, the row sums $w + t\,G e$, where e are the last one's,
    and the right-hand side $b + t\,G b'$. Keeping the row sums in place of the diagonal leaves
    nothing to subtract, so that no digit is lost at any contrast (Grassmann, Taksar & Heyman 1985):
    the error is the rounding of the largest label.
    """
    y, x = right.shape[-2:]
    tx, ty = pad(coefficients.tx, (0, 0), (0, 1)), pad(coefficients.ty, (0, 1), (0, 0))
    along, across = (tx, ty) if y <= x else (ty, tx)
    weight, ahead, within, data = (
        _in_order(images) for images in (coefficients.weight, along, across, right)
    )

    def forward(front: _Front, column: tuple[Array, Array, Array, Array]) -> tuple[_Front, Any]:
        weight, ahead, within, data = column
        tableau = no_fuse(_next_column, front, weight, ahead, within, data)
        data = tableau[:, -1]
        for pivot in range(tableau.shape[0]):
            tableau = no_fuse(partial(_sweep, pivot=pivot), tableau)
        return _Front(tableau, ahead), (tableau[:, : tableau.shape[0]], data)

    height, batch = data.shape[1:]
    front = _Front(jnp.zeros((height, height + 3, batch), right.dtype), jnp.zeros_like(data[0]))
    inverses, carried = lax.scan(forward, front, (weight, ahead, within, data))[1]
    return _Eliminated(inverses, ahead), carried


def _forwards(eliminated: _Eliminated, data: Array) -> Array:
    """Right-hand sides of the columns after the elimination of those before, `[w, h, b]`."""

    def step(before: Array, column: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        at, data, ahead = column
        carried = _opaque(data + before)
        return ahead * _times(eliminated.inverses, at, carried), carried

    columns = (jnp.arange(len(data)), data, eliminated.ahead)
    return lax.scan(step, jnp.zeros_like(data[0]), columns)[1]


def _backwards(eliminated: _Eliminated, carried: Array) -> Array:
    """The solution from the result of `_forwards`; zero where nothing is tied to data."""

    def step(later: Array, column: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        at, carried, ahead = column
        value = _times(eliminated.inverses, at, _opaque(carried + ahead * later))
        return value, value

    columns = (jnp.arange(len(carried)), carried, eliminated.ahead)
    return lax.scan(step, jnp.zeros_like(carried[0]), columns, reverse=True)[1]


def _times(inverses: Array, at: Array, right: Array) -> Array:
    """The inverse of a column's matrix, times `right`."""
    return _sum(inverses[at, j] * right[j][None] for j in range(len(right)))


def _next_column(front: _Front, weight: Array, ahead: Array, within: Array, data: Array) -> Array:
    """The tableau of the next column: ties between its pixels, `[h, h, b]`, and three columns more.

    These are row sums with and without the ties ahead, and the right-hand side.

    Args:
        front: the last column.
        weight: data weights of the next column.
        ahead: its ties to the column after it.
        within: ties between its neighbors.
        data: its right-hand side.
    """
    solved, tie = front
    height = tie.shape[0]
    above = jnp.concatenate([jnp.zeros_like(tie[:1]), within[:-1]])
    next_to = np.eye(height, k=1)
    ties = _as(next_to, tie) * within[:, None] + _as(next_to.T, tie) * above[:, None]
    ties = solved[:, :height] * tie[:, None] * tie[None] + ties
    sums = solved[:, -2] * tie + weight
    right = solved[:, -1] * tie + data
    return jnp.concatenate([ties, jnp.stack([sums + ahead, sums, right], 1)], 1)


def _sweep(tableau: Array, *, pivot: int) -> Array:
    """Eliminates one pixel of a tableau (sweep operator, by additions only).

    Ties between two swept pixels become entries of the inverse; those between a swept and another
    pixel, the probability of a random walk to leave by the other. The diagonal is not used before
    its pixel is swept. A pixel without ties changes nothing.
    """
    height, width = tableau.shape[:2]
    # Row and column hold the same ties, but their product is faster than that of the row alone.
    row, column = tableau[pivot], tableau[:, pivot]
    total = row[height] + _sum(row[j] for j in range(pivot + 1, height))
    alive = total > 0
    share = jnp.where(alive, 1 / jnp.where(alive, total, 1), 0)
    here = np.arange(width) == pivot
    there = here[:height]
    row = _as(~here, row) * row + _as(here, row)
    column = (_as(~there, row) * column + _as(there, row)) * share[None]
    return _as(~there[:, None] & ~here, row) * tableau + column[:, None] * row[None]


def _sum(terms: Iterable[Array]) -> Any:
    """Sum of the terms, written out; 0 if there are none."""
    total: Any = 0
    for term in terms:
        total = total + term
    return total


def _opaque(values: Array) -> Array:
    """The values, divided by a one that is opaque to the compiler."""
    return values / jnp.where(jnp.isinf(values), values, 1)


def _as(mask: np.ndarray, like: Array) -> Array:
    """A mask of the leading axes, as numbers."""
    return jnp.asarray(mask[..., None], like.dtype)


def _in_order(images: Array) -> Array:
    """From images to columns in the order of elimination, batch last."""
    y, x = images.shape[-2:]
    return jnp.transpose(images.reshape(-1, y, x), (2, 1, 0) if y <= x else (1, 2, 0))


def _as_images(columns: Array, shape: tuple[int, ...]) -> Array:
    """The inverse of `_in_order`."""
    return jnp.transpose(columns, (2, 1, 0) if shape[-2] <= shape[-1] else (2, 0, 1)).reshape(shape)
