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
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.image import gaussian
from mvedge_jax.photometry import Sight
from mvedge_jax.photometry.measuring import (
    Look,
    Measuring,
    PhotometricLabels,
    labels,
    look_around,
    mismatch,
)
from mvedge_jax.photometry.photographs import PosedSight

from ._parameters import CentreParams
from ._sharpen import Sharpening
from ._slant import rises, slope_labels
from ._smoothness import SmoothnessParams, edge_smoothness
from .error import spread, steepest

# A point whose disparity differs by this from the map, px, has a quarter of its weight.
AGREEMENT = 0.15
# Weight of the previous map itself, so that no region is without any label.
_ANCHOR = 1e-6
# A pixel follows the sharpened map unless its residual grows by more than this factor (plus twice
# this, squared noise): the median would swallow structures that are thinner than half of its
# window, and the views know better. At first thin structures are not yet fitted to the views.
_WORSE_FIRST, _WORSE = 1.2, 2.0
# Differences of neighbours beyond this, px, are steps rather than slopes.
_STEEPEST = 0.3
# Weight of the slope 0 against that of a perfect label.
_FLAT = 1e-4
# Standard deviation and reach, px, of the Gaussian that a map passes before its steps cut edges.
_BLUR, _BLUR_REACH = 0.5, 2
# Beyond this distance from any label, px, a map tells no more about a surface than its own spread.
# From cotton, backgammon, room, bench and the nine rendered scenes.
_FORGOTTEN = 55.0
# What a turn does: a solve, measured around the last map in the crosshair or in all views; a look
# at a map that will be sharpened; sharpening and a solve.
_PLAIN, _AROUND, _BLURRED, _SHARPENED = range(4)
# Solves whose labels are measured in all views, where these are asked for.
_AROUND_SOLVES = 2
# A step of this, px, within this distance of a pixel halves the share that all views have in its
# label: the views of the corners look past an edge on two sides, and smear it. From cotton,
# backgammon, bench and demo.
_PARTED, _BESIDE = 0.1, 2
# Which of the four diffusions is which; those of the slopes come first.
_MAP, _ERROR = 2, 3


class Labels(NamedTuple):
    """Labels and data weights per pixel.

    Attributes:
        weight: against a perfect label, `[y, x]`.
        value: disparity, `[y, x]`.
    """

    weight: Array
    value: Array


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
    """

    disparity: Array
    error: Array
    iterations: Array
    converged: Array


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
    every = views.grid if isinstance(views, Sight) else None
    kinds = _kinds(sizes, every=every is not None)

    def everywhere(found: Look) -> Look:
        return found._replace(views=jnp.broadcast_to(found.views, found.right.shape))

    @staged
    def look(disparity: Array) -> Look:
        found = everywhere(views.look(disparity, radius=sizes.radius))
        return found if every is None else found._replace(cross=jnp.zeros_like(disparity))

    @recomputed
    def disagreement(found: Look, disparity: Array) -> Array:
        return mismatch(found, lab, disparity, views.params, passes=sizes.passes)

    def around(found: Look, disparity: Array) -> Look:
        assert every is not None
        whole = everywhere(look_around(every, disparity, views.params, radius=sizes.radius))
        share = _whole(disparity)
        return jax.tree.map(lambda a, c: share * a + (1 - share) * c, whole, found)

    @staged
    def measured(found: Look, disparity: Array) -> PhotometricLabels:
        return labels(found, lab, disparity, views.params, passes=sizes.passes)

    def solve(found: Look, disparity: Array, turn: _Turn) -> Any:
        sparse = from_points
        if every is not None:
            # Points were measured in the crosshair, and have no say against all views.
            share = jnp.where(turn.kind == _AROUND, 1 - _whole(disparity), 1)
            sparse = sparse._replace(weight=share * sparse.weight)
        return _solved(
            _with_dense(
                sparse,
                kept(measured(found, disparity)),
                disparity,
                params.centre,
                views.params,
                lit,
            ),
            _cuts(lab, disparity, params.smoothness, lit),
            disparity,
            span,
            params.centre,
            sizes,
            sloped=turn.sloped,
            last=turn.last,
        )

    # One look and one solver for all turns keep the program small: what differs between turns is a
    # branch, and the two maps that a sharpening compares are looked at in turns of their own.
    def step(state: _State, turn: _Turn) -> tuple[_State, tuple[Array, Array]]:
        disparity, error, blurred = state
        if blurred is None:
            found = kept(look(disparity))
        else:
            sharpens = turn.kind == _SHARPENED
            moved = kept(lax.cond(sharpens, sharper, lambda d: d, disparity))
            found = kept(look(moved))
            compared = sharpens | (turn.kind == _BLURRED)
            differs = lax.cond(compared, disagreement, lambda _, d: jnp.zeros_like(d), found, moved)
            allowed = turn.slack * (blurred.mismatch + 2 * views.params.noise**2)
            # What was seen of the chosen map need not be looked up again.
            disparity, found = jax.tree.map(
                partial(jnp.where, sharpens & (differs > allowed)),
                (disparity, blurred.found),
                (moved, found),
            )
            blurred = _Blurred(found, differs)
        if every is not None:
            found = lax.cond(turn.kind == _AROUND, around, lambda found, _: found, found, disparity)

        (disparity, error), stats = lax.cond(
            turn.kind == _BLURRED,
            lambda: ((disparity, error), (jnp.zeros((), jnp.int32), jnp.asarray(True))),
            lambda: solve(found, disparity, turn),
        )
        return _State(disparity, error, blurred), stats

    nothing = jnp.zeros_like(first)
    state = _State(first, nothing, None)
    if _BLURRED in kinds:
        unseen = jax.tree.map(lambda of: jnp.zeros(of.shape, of.dtype), jax.eval_shape(look, first))
        state = state._replace(blurred=_Blurred(unseen, nothing))
    state, (iterations, converged) = lax.scan(recomputed(step), state, _turns(kinds, first.dtype))
    solves = np.flatnonzero(kinds != _BLURRED)
    return Map(state.disparity, state.error, iterations[solves], jnp.all(converged))


class _Turn(NamedTuple):
    """What is done in a turn of `dense_map`."""

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


class _Solve(NamedTuple):
    """One diffusion of the four: those of either slope, of the map and of its error."""

    which: Array
    wanted: Array
    weight: Array
    label: Array
    start: Array
    stiffness: Array
    tolerance: Array


def _solved(
    labels: Labels,
    edges: tuple[Array, Array],
    start: Array,
    span: Array,
    params: CentreParams,
    sizes: SolveSizes,
    *,
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
        tolerance=sizes.tolerance * jnp.asarray([10, 10, 1, 10], start.dtype),
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


def _with_dense(
    from_points: Labels,
    measured: PhotometricLabels,
    disparity: Array,
    params: CentreParams,
    measuring: Measuring,
    lit: Array | None,
) -> Labels:
    """Labels of the points together with one measured at every pixel."""
    weight = measured.weight(measuring, precision=params.precision, trust=params.trust)
    distance = (from_points.value - disparity) / AGREEMENT
    sparse = from_points.weight / (1 + distance**2) ** 2
    if lit is not None:
        weight, sparse = lit * weight, lit * sparse
    total = weight + sparse + _ANCHOR
    sums = weight * measured.disparity + sparse * from_points.value + _ANCHOR * disparity
    return Labels(total, sums / jnp.maximum(total, jnp.finfo(total.dtype).tiny))


def _cuts(
    lab: Array, disparity: Array, params: SmoothnessParams, lit: Array | None
) -> tuple[Array, Array]:
    """Smoothness by the steps of a map: full between neighbours of which one is not `lit`."""
    tx, ty = edge_smoothness(lab, _smooth(disparity), params)
    if lit is None:
        return tx, ty
    across, down = lit[:, 1:] * lit[:, :-1], lit[1:] * lit[:-1]
    return jnp.maximum(tx, 1 - across), jnp.maximum(ty, 1 - down)


def precision_weight(variance: Array, params: CentreParams) -> Array:
    """Weight of a label against that of a perfect one.

    Args:
        variance: of the label, px².
        params: `precision` is the standard error that halves the weight.

    Returns:
        The weight, at most 1. Differentiable.
    """
    precision = params.precision**2
    return precision / (precision + variance)


def _whole(disparity: Array) -> Array:
    """Share of all views against the crosshair in the label of a pixel: 1 far from steps."""
    window = (2 * _BESIDE + 1,) * 2
    step = lax.reduce_window(steepest(disparity), -jnp.inf, lax.max, window, (1, 1), "SAME")
    return 1 / (1 + (step / _PARTED) ** 4)


def _smooth(disparity: Array) -> Array:
    """The map whose steps cut edges."""
    return gaussian(disparity, jnp.asarray(_BLUR, disparity.dtype), _BLUR_REACH)
