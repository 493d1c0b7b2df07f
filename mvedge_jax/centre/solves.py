"""The solves of the centre view: labels, measured anew around every map, and their diffusion."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from mvedge_jax._fence import kept, recomputed, staged
from mvedge_jax.photometry import Sight
from mvedge_jax.photometry.measuring import (
    Look,
    PhotometricLabels,
    labels,
    look_around,
    mismatch,
)
from mvedge_jax.photometry.photographs import PosedSight

from ._diffused import diffused
from ._labels import Labels as Labels, share_of_all, with_dense
from ._parameters import CentreParams
from ._sharpen import Sharpening
from ._smoothness import SmoothnessParams, cuts

# A pixel follows the sharpened map unless its residual grows by more than this factor (plus twice
# this, squared noise): the median would swallow structures that are thinner than half of its
# window, and the views know better. At first thin structures are not yet fitted to the views.
_WORSE_FIRST, _WORSE = 1.2, 2.0
# What a turn does: a solve, measured around the last map in the crosshair or in all views; a look
# at a map that will be sharpened; sharpening and a solve.
_PLAIN, _AROUND, _BLURRED, _SHARPENED = range(4)
# Solves whose labels are measured in all views, where these are asked for.
_AROUND_SOLVES = 2
# A label of less weight than this, against a perfect one, is not accepted: its standard error is
# ten times `CentreParams.precision`, or the views disagree about its pixel.
_ACCEPTED = 0.01


@runtime_checkable
class SolveParams(Protocol):
    """The parameters that the solves read."""

    smoothness: SmoothnessParams
    centre: CentreParams


@runtime_checkable
class SolveSizes(Protocol):
    """The sizes that the solves read; see `Sizes`."""

    @property
    def radius(self) -> int:
        """How far occluders are looked for, px."""
        ...

    @property
    def passes(self) -> int:
        """Over the neighbours whose measurements are shared."""
        ...

    @property
    def solves(self) -> int:
        """Diffusions before the sharpening, and again after it."""
        ...

    @property
    def sharpening(self) -> Sharpening:
        """See `sharpen`."""
        ...

    @property
    def tolerance(self) -> float:
        """At which the diffusion stops."""
        ...


class Map(NamedTuple):
    """A map, the standard error of its labels, and how the diffusions went.

    Attributes:
        disparity: `[y, x]`.
        error: of the labels that every pixel is made from; 0 without labels. `standard_error` makes
            it that of the map.
        iterations: of every diffusion of the map.
        converged: whether all diffusions reached their tolerance.
        labelled: share of the pixels with an accepted label in the last solve.
    """

    disparity: Array
    error: Array
    iterations: Array
    converged: Array
    labelled: Array


def dense_map(
    from_points: Labels,
    views: Sight | PosedSight,
    lab: Float[Array, "c y x"],
    first: Float[Array, "y x"],
    span: Float[Array, ""],
    sharper: Callable[[Array], Array],
    params: SolveParams,
    sizes: SolveSizes,
    *,
    lit: Float[Array, "y x"] | None = None,
) -> Map:
    """Repeated measurement in the views and diffusion, with slopes from the second solve on.

    Args:
        from_points: labels from elsewhere, of weight 0 where there is none.
        views: of a light field or of posed photographs, made ready.
        lab: the reference view in CIELAB, denoised.
        first: where to start, `[y, x]`.
        span: width of the range that was tried, px: the standard error of a map without evidence.
        sharper: moves blurred steps of a map, see `sharpen`.
        params: `smoothness` and `centre` are read.
        sizes: see `SolveSizes`.
        lit: 0 where there is nothing of the scene to see: no label counts, and no step is cut.

    Returns:
        The map. Differentiable.
    """
    given = _Given(from_points, views, lab, span, params, lit)
    every = _every(given) is not None
    kinds = _kinds(sizes, every=every)

    # One look and one solver for all turns keep the program small: what differs between turns is a
    # branch, and the two maps that a sharpening compares are looked at in turns of their own.
    def step(state: _State, turn: _Turn) -> tuple[_State, tuple[Array, Array, Array]]:
        if state.blurred is None:
            found = kept(_look(given, state.disparity, sizes))
        else:
            state, found = _sharpened(given, state, turn, sharper, sizes)
        if every:
            around = partial(_around, given, sizes=sizes)
            found = lax.cond(turn.kind == _AROUND, around, lambda f, _: f, found, state.disparity)
        (disparity, error), stats = lax.cond(
            turn.kind == _BLURRED,
            lambda: (
                state[:2],
                (jnp.zeros((), jnp.int32), jnp.asarray(True), jnp.zeros_like(span)),
            ),
            lambda: _solve(given, found, state.disparity, turn, sizes),
        )
        return state._replace(disparity=disparity, error=error), stats

    nothing = jnp.zeros_like(first)
    state = _State(first, nothing, None)
    if _BLURRED in kinds:
        shapes = jax.eval_shape(lambda d: _look(given, d, sizes), first)
        unseen = jax.tree.map(lambda of: jnp.zeros(of.shape, of.dtype), shapes)
        state = state._replace(blurred=_Blurred(unseen, nothing))
    state, stats = lax.scan(recomputed(step), state, _turns(kinds, first.dtype))
    iterations, converged, labelled = stats
    solves = np.flatnonzero(kinds != _BLURRED)
    return Map(
        state.disparity, state.error, iterations[solves], jnp.all(converged), labelled[solves[-1]]
    )


class _Given(NamedTuple):
    """What all turns of `dense_map` read."""

    from_points: Labels
    views: Sight | PosedSight
    lab: Array
    span: Array
    params: SolveParams
    lit: Array | None


class _Turn(NamedTuple):
    """What is done in a turn of `dense_map`.

    Attributes:
        kind: see `_PLAIN`.
        slack: by which factor a sharpened map may disagree more with the views.
        sloped: whether the solve goes along the slopes of the map.
        last: whether the error of the map is asked for.
    """

    kind: Array
    slack: Array
    sloped: Array
    last: Array


class _Blurred(NamedTuple):
    """What the views show of a map before it is sharpened, and how far they disagree with it."""

    found: Look
    mismatch: Array


class _State(NamedTuple):
    """What a turn of `dense_map` hands on to the next."""

    disparity: Array
    error: Array
    blurred: _Blurred | None


def _kinds(sizes: SolveSizes, *, every: bool) -> np.ndarray:
    """The kinds of turns of `dense_map`, in their order."""
    if sizes.sharpening == "none":
        kinds = [_PLAIN] * sizes.solves
    else:
        kinds = [_BLURRED, _SHARPENED, *[_PLAIN] * (sizes.solves - 1)] * 2
    return np.asarray(kinds + [_AROUND] * (_AROUND_SOLVES if every else 0))


def _turns(kinds: np.ndarray, dtype: DTypeLike) -> _Turn:
    index, first = np.arange(len(kinds)), np.flatnonzero(kinds != _BLURRED)[0]
    return _Turn(
        jnp.asarray(kinds),
        jnp.asarray(np.where(index == first, _WORSE_FIRST, _WORSE), dtype),
        jnp.asarray(index > first),
        jnp.asarray(index == len(kinds) - 1),
    )


def _every(given: _Given) -> Any:
    """All views, where labels are measured in them."""
    return given.views.grid if isinstance(given.views, Sight) else None


def _look(given: _Given, disparity: Array, sizes: SolveSizes) -> Look:
    """What the views of the crosshair, or the photographs, show around a map."""

    @staged
    def look(disparity: Array) -> Look:
        found = given.views.look(disparity, radius=sizes.radius).per_pixel()
        alone = _every(given) is None
        return found if alone else found._replace(cross=jnp.zeros_like(disparity))

    return look(disparity)


def _around(given: _Given, found: Look, disparity: Array, *, sizes: SolveSizes) -> Look:
    """What all views show around a map; beside its steps, what the crosshair does."""
    whole = look_around(_every(given), disparity, given.views.params, radius=sizes.radius)
    share = share_of_all(disparity)
    return jax.tree.map(lambda a, c: share * a + (1 - share) * c, whole.per_pixel(), found)


def _sharpened(
    given: _Given,
    state: _State,
    turn: _Turn,
    sharper: Callable[[Array], Array],
    sizes: SolveSizes,
) -> tuple[_State, Look]:
    """The map, sharpened where the views do not mind, if it is the turn for that; and its look."""
    assert state.blurred is not None
    sharpens, noise = turn.kind == _SHARPENED, given.views.params.noise

    def disagreement(found: Look, disparity: Array) -> Array:
        return mismatch(found, given.lab, disparity, given.views.params, passes=sizes.passes)

    moved = kept(lax.cond(sharpens, sharper, lambda d: d, state.disparity))
    found = kept(_look(given, moved, sizes))
    compared = sharpens | (turn.kind == _BLURRED)
    differs = lax.cond(compared, disagreement, lambda _, d: jnp.zeros_like(d), found, moved)
    minds = sharpens & (differs > turn.slack * (state.blurred.mismatch + 2 * noise**2))
    # What was seen of the chosen map need not be looked up again.
    disparity, found = jax.tree.map(
        partial(jnp.where, minds), (state.disparity, state.blurred.found), (moved, found)
    )
    return _State(disparity, state.error, _Blurred(found, differs)), found


def _solve(given: _Given, found: Look, disparity: Array, turn: _Turn, sizes: SolveSizes) -> Any:
    """Labels at every pixel, with those of the points, diffused."""

    @staged
    def measured(found: Look, disparity: Array) -> PhotometricLabels:
        return labels(found, given.lab, disparity, given.views.params, passes=sizes.passes)

    params, sparse = given.params, given.from_points
    if _every(given) is not None:
        # Points were measured in the crosshair, and have no say against all views.
        share = jnp.where(turn.kind == _AROUND, 1 - share_of_all(disparity), 1)
        sparse = sparse._replace(weight=share * sparse.weight)
    dense = kept(measured(found, disparity))
    both = with_dense(sparse, dense, disparity, params.centre, given.views.params, given.lit)
    solved, (iterations, converged) = diffused(
        both,
        cuts(given.lab, disparity, params.smoothness, given.lit),
        disparity,
        given.span,
        params.centre,
        tolerance=sizes.tolerance,
        sloped=turn.sloped,
        last=turn.last,
    )
    labelled = jnp.mean((both.weight >= _ACCEPTED).astype(disparity.dtype))
    return solved, (iterations, converged, labelled)
