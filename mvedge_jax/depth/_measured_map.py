"""The map of dense labels, which are measured again around every map."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from mvedge_jax._checkpoint import checkpoint, save_residual
from mvedge_jax._cpu import checkpoint_stage
from mvedge_jax.photometry import PreparedViews
from mvedge_jax.photometry.measuring import (
    NormalEquations,
    PhotometricLabels,
    labels,
    residual_variance,
)

from ._dense import LabelContext
from ._diffused import diffused
from ._labels import Labels
from ._refine import Given, Map, Parts, Refine, cut_edges, labeled_share
from ._standard_error import steepest

# What a turn does: a solve, measured around the last map in the crosshair or in all views; a look
# at a map that will be sharpened; sharpening and a solve; nothing.
_PLAIN, _AROUND, _BLURRED, _SHARPENED, _IDLE = range(5)


def measured_map(given: Given, first: Float[Array, "y x"], parts: Parts) -> Map:
    """Repeated measurement in the views, sharpening and diffusion; see `refine_disparity`.

    Args:
        given: see `Given`; `views` must not be None.
        first: initial disparity, px per view step.
        parts: parts of the chain; `dense` must not be None.

    Returns:
        The map. Differentiable.
    """
    every = _every(given) is not None
    kinds = _kinds(parts.refine, every=every)

    # One accumulation and one solver in the loop keep the program small. Steps differ by a branch,
    # and the two maps that a sharpening compares are measured in steps of their own.
    def step(state: _State, turn: Turn) -> tuple[_State, tuple[Array, Array, Array]]:
        state, found = _measured(given, state, turn, parts)
        if every:
            around = partial(_around, given, parts=parts)
            found = lax.cond(turn.kind == _AROUND, around, lambda f, _: f, found, state.disparity)
        (disparity, error), stats = lax.cond(
            turn.kind == _BLURRED,
            lambda: (
                state[:2],
                (jnp.zeros((), jnp.int32), jnp.asarray(True), jnp.zeros_like(given.span)),
            ),
            lambda: _solve(given, found, state.disparity, turn, parts),
        )
        return state._replace(disparity=disparity, error=error), stats

    turns = _turns(kinds, parts.refine, first.dtype)
    start = _start(given, first, sharpens=_BLURRED in kinds)
    state, (iterations, converged, labeled) = lax.scan(checkpoint(step), start, turns)
    solves = np.flatnonzero(kinds != _BLURRED)
    return Map(
        state.disparity, state.error, iterations[solves], jnp.all(converged), labeled[solves[-1]]
    )


def turns_by_solve(refine: Refine, dtype: DTypeLike) -> list["Turn"]:
    """The two turns up to every solve, the first of which may be idle."""
    kinds = _kinds(refine, every=False)
    turns, pairs = _turns(kinds, refine, dtype), []
    for last in np.flatnonzero(kinds != _BLURRED).tolist():
        before = max(last - 1, 0)
        kind = jnp.asarray([_BLURRED if kinds[before] == _BLURRED else _IDLE, kinds[last]])
        slack, sloped, final = (jnp.stack([of[before], of[last]]) for of in turns[1:4])
        pairs.append(Turn(kind, slack, sloped, final))
    return pairs


def measured_labels(
    given: Given, disparity: Float[Array, "y x"], turns: "Turn", parts: Parts
) -> tuple[Float[Array, "y x"], Labels]:
    """The local part of `measured_map` up to a solve: what it starts from, and its labels.

    Args:
        given: see `measured_map`; it may be a part of an image.
        disparity: the map so far.
        turns: see `turns_by_solve`.
        parts: see `measured_map`.

    Returns:
        The map, sharpened where the residual allows it, and the labels measured around it.
    """

    def visit(so_far: Any, turn: Turn) -> tuple[Any, None]:
        look = partial(_measured, given, so_far[0], turn, parts)
        return lax.cond(turn.kind == _IDLE, lambda: so_far, look), None

    sharpens = parts.refine.sharpen.mode != "none"
    start = _start(given, disparity, sharpens=sharpens), _unseen(given, disparity)
    (state, found), _ = lax.scan(visit, start, turns)
    last = jax.tree.map(lambda of: of[-1], turns)
    return state.disparity, _labels(given, found, state.disparity, last, parts)


class Turn(NamedTuple):
    """One step of the loop of `measured_map`.

    Attributes:
        kind: see `_PLAIN`.
        slack: factor by which the residual of a sharpened map may be larger.
        sloped: whether the solve uses the slopes of the map.
        last: whether to compute the error of the map.
        ends: least and largest disparity of the whole map, where this one is a part of it.
    """

    kind: Array
    slack: Array
    sloped: Array
    last: Array
    ends: tuple[Array, Array] | None = None


class _Blurred(NamedTuple):
    """Measurement around a map before sharpening, and its residual variance."""

    found: NormalEquations
    residual_variance: Array


class _State(NamedTuple):
    """The loop state of `measured_map`."""

    disparity: Array
    error: Array
    blurred: _Blurred | None


def _kinds(refine: Refine, *, every: bool) -> np.ndarray:
    """The kinds of the steps, in order."""
    if refine.sharpen.mode == "none":
        kinds = [_PLAIN] * refine.solves
    else:
        kinds = [_BLURRED, _SHARPENED, *[_PLAIN] * (refine.solves - 1)] * 2
    return np.asarray(kinds + [_AROUND] * (refine.around if every else 0))


def _turns(kinds: np.ndarray, refine: Refine, dtype: DTypeLike) -> Turn:
    index, first = np.arange(len(kinds)), np.flatnonzero(kinds != _BLURRED)[0]
    return Turn(
        jnp.asarray(kinds),
        jnp.where(index == first, refine.worse_at_first, refine.worse).astype(dtype),
        jnp.asarray(index > first),
        jnp.asarray(index == len(kinds) - 1),
    )


def _every(given: Given) -> Any:
    """All views if labels are measured in them, else None."""
    return None if given.views is None else given.views.every


def _views(given: Given) -> PreparedViews:
    if given.views is None:
        raise ValueError("dense labels need a `measurement` in the chain, got None.")
    return given.views


def _look(given: Given, disparity: Array) -> NormalEquations:
    """Accumulates the crosshair's or the photographs' normal equations around a map."""

    @checkpoint_stage
    def look(disparity: Array) -> NormalEquations:
        found = _views(given).accumulate(disparity).per_pixel()
        alone = _every(given) is None
        return found if alone else found._replace(cross=jnp.zeros_like(disparity))

    return look(disparity)


def _around(
    given: Given, found: NormalEquations, disparity: Array, *, parts: Parts
) -> NormalEquations:
    """Mixes the normal equations of all views with those of the crosshair beside steps."""
    whole = _every(given).accumulate(disparity, _views(given).params)
    share = _share_of_all(disparity, parts.refine)
    return jax.tree.map(lambda a, c: share * a + (1 - share) * c, whole.per_pixel(), found)


def _start(given: Given, first: Array, *, sharpens: bool) -> _State:
    """The state before the first turn."""
    nothing = jnp.zeros_like(first)
    if not sharpens:
        return _State(first, nothing, None)
    return _State(first, nothing, _Blurred(_unseen(given, first), nothing))


def _unseen(given: Given, disparity: Array) -> NormalEquations:
    """Zeros in the shape of what `_look` returns."""
    shapes = jax.eval_shape(partial(_look, given), disparity)
    return jax.tree.map(lambda of: jnp.zeros(of.shape, of.dtype), shapes)


def _measured(
    given: Given, state: _State, turn: Turn, parts: Parts
) -> tuple[_State, NormalEquations]:
    """Looks at the map and sharpens it where the residual allows it."""
    if state.blurred is None:
        return state, save_residual(_look(given, state.disparity))
    sharpens, params = turn.kind == _SHARPENED, _views(given).params

    def disagreement(found: NormalEquations, disparity: Array) -> Array:
        return residual_variance(found, given.lab, disparity, params, passes=params.passes)

    def sharper(disparity: Array) -> Array:
        return parts.refine.sharpen(disparity, given.guide, ends=turn.ends)

    moved = save_residual(lax.cond(sharpens, sharper, lambda d: d, state.disparity))
    found = save_residual(_look(given, moved))
    compared = sharpens | (turn.kind == _BLURRED)
    differs = lax.cond(compared, disagreement, lambda _, d: jnp.zeros_like(d), found, moved)
    minds = sharpens & (
        differs > turn.slack * (state.blurred.residual_variance + 2 * params.noise**2)
    )
    # The chosen map has been measured already.
    disparity, found = jax.tree.map(
        partial(jnp.where, minds), (state.disparity, state.blurred.found), (moved, found)
    )
    return _State(disparity, state.error, _Blurred(found, differs)), found


def _labels(
    given: Given, found: NormalEquations, disparity: Array, turn: Turn, parts: Parts
) -> Labels:
    """Dense labels together with those of the points."""
    params, refine, sparse = _views(given).params, parts.refine, given.from_points
    assert parts.dense is not None

    @checkpoint_stage
    def measured(found: NormalEquations, disparity: Array) -> PhotometricLabels:
        return labels(found, given.lab, disparity, params, passes=params.passes)

    if _every(given) is not None:
        # Points were measured in the crosshair only, so they do not override all views.
        alone = 1 - _share_of_all(disparity, refine)
        share = jnp.where(turn.kind == _AROUND, alone, 1)
        sparse = sparse._replace(weight=share * sparse.weight)
    dense = save_residual(measured(found, disparity))
    context = LabelContext(params, refine.precision, given.lab, given.hypotheses, given.lit)
    return parts.dense(sparse, dense, disparity, context)


def _solve(given: Given, found: NormalEquations, disparity: Array, turn: Turn, parts: Parts) -> Any:
    """Diffuses all labels."""
    both = _labels(given, found, disparity, turn, parts)
    solved, (iterations, converged) = diffused(
        both,
        cut_edges(given, disparity, parts.smoothness),
        disparity,
        given.span,
        parts.refine,
        parts.solver,
        sloped=turn.sloped,
        last=turn.last,
    )
    return solved, (iterations, converged, labeled_share(both, parts.refine))


def _share_of_all(disparity: Array, refine: Refine) -> Array:
    """Share of all views, against the crosshair, in a pixel's label: 1 far from steps."""
    window = (2 * refine.beside + 1,) * 2
    step = lax.reduce_window(steepest(disparity), -jnp.inf, lax.max, window, (1, 1), "SAME")
    return 1 / (1 + (step / refine.parted) ** 4)
