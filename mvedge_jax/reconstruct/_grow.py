"""Adding points where the map is wrong, in the place of points that do nothing."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from mvedge_jax._params import cast, number

from ._model import DepthModel, ModelParams, ModelSizes, opacities, splat_model
from ._objectives import SelfSupervised, Supervised
from ._optimise import History, Objective, State, optimise, parts_of, settled_moments, with_parts
from ._routine import Routine


class GrowParams(eqx.Module):
    """When a point gives up its place, and what for.

    Attributes:
        least: points that contribute less than this may be replaced, see `usefulness`; 0 keeps
            all points, so that only free places are filled.
        threshold: pixels that are wrong by no more than this need no point, px per view step.
    """

    least: Float[Array, ""] = number(0.2)
    threshold: Float[Array, ""] = number(0.01)


class Grown(NamedTuple):
    """What adding points did.

    Attributes:
        state: with the new points; Adam's moments of each are those of its first gradient.
        objective: whose trust knows the new points.
        added: how many points are new.
        recycled: how many of them took the place of a point that did nothing.
        refused: how many found no place.
    """

    state: State
    objective: Supervised | SelfSupervised
    added: Int[Array, ""]
    recycled: Int[Array, ""]
    refused: Int[Array, ""]


def without_free_places(model: DepthModel) -> DepthModel:
    """Drops the places of a model that hold no point.

    Args:
        model: the model, not traced: how many points there are sets the shape.

    Returns:
        The model with as many places as points, in their order.
    """
    there = np.flatnonzero(np.asarray(model.valid))
    return DepthModel(
        model.disparity[there],
        model.xy[there],
        model.log_weight[there],
        model.roughness,
        model.valid[there],
    )


def with_capacity(model: DepthModel, capacity: int) -> DepthModel:
    """Appends free places to the model.

    Args:
        model: the model.
        capacity: number of places, at least what the model has.

    Returns:
        The model with `capacity` places.

    Raises:
        ValueError: the model has more places already.
    """
    extra = capacity - model.valid.size
    if extra < 0:
        raise ValueError(
            f"`capacity` is {capacity}, but the model has {model.valid.size} places already."
        )
    return DepthModel(
        jnp.pad(model.disparity, (0, extra)),
        jnp.pad(model.xy, ((0, extra), (0, 0))),
        jnp.pad(model.log_weight, (0, extra)),
        model.roughness,
        jnp.pad(model.valid, (0, extra)),
    )


def usefulness(model: DepthModel, params: ModelParams, sizes: ModelSizes) -> Float[Array, "n"]:
    """How much data weight each point contributes to the map, in raster pixels.

    A point in the open contributes about `exp(-R)` times 1.4; one that nearer neighbours hide
    contributes next to nothing, and gets next to no gradient.

    Args:
        model: the points.
        params: of the rendering.
        sizes: of the rendering.

    Returns:
        Σ over pixels of w λ T; zero for places that are free.
    """
    weight = jnp.exp(-model.log_weight)
    opacity = opacities(model, params, sizes)

    def total(weight: Array) -> Array:
        return jnp.sum(splat_model(model, weight, opacity, params, sizes).weight)

    return jnp.where(model.valid, weight * jax.grad(total)(weight), 0)


def worst_pixels(
    residual: Float[Array, "y x"], count: int, *, block: int = 2
) -> tuple[Int[Array, "n 2"], Float[Array, "n"]]:
    """The pixels of largest residual, at most one per block.

    Args:
        residual: how wrong the map is, >= 0.
        count: how many pixels.
        block: side of the blocks, px.

    Returns:
        `(x, y)` and the residual there, largest first. There may be fewer blocks than `count`.
    """
    height, width = residual.shape
    rows, columns = -(-height // block), -(-width // block)
    padded = jnp.pad(
        residual,
        ((0, rows * block - height), (0, columns * block - width)),
        constant_values=-jnp.inf,
    )
    cells = padded.reshape(rows, block, columns, block).transpose(0, 2, 1, 3)
    cells = cells.reshape(rows * columns, block * block)
    value, cell = jax.lax.top_k(jnp.max(cells, axis=1), min(count, rows * columns))
    inside = jnp.argmax(cells, axis=1).astype(cell.dtype)[cell]
    x = cell % columns * block + inside % block
    y = cell // columns * block + inside // block
    return jnp.stack([x, y], axis=-1), value


@eqx.filter_jit
def grow(
    state: State,
    objective: Supervised | SelfSupervised,
    residual: Float[Array, "y x"],
    label: Float[Array, "y x"],
    params: GrowParams,
    *,
    count: int,
) -> Grown:
    """Puts new points where the residual is largest.

    Free places are used first, then those of the points that contribute least (nearly all are
    points that nearer neighbours hide: recycling is what brings them back, since they receive no
    gradient of their own; `ModelSizes.clears` has the measurement).

    Args:
        state: of the optimisation.
        objective: what is minimised; its trust takes the new points in.
        residual: how wrong the map is, per pixel.
        label: what new points say at each pixel.
        params: see `GrowParams`.
        count: most points to add.

    Returns:
        The new state and objective, and counts.

    Source:
        Named as future work in thesis 8.1.1.
    """
    model = state.model
    dtype = model.disparity.dtype
    params = cast(params, dtype)
    use = usefulness(model, cast(objective.params, dtype), objective.sizes)
    xy, value = worst_pixels(residual, min(count, model.valid.size))
    place = jnp.argsort(jnp.where(model.valid, use, -1))[: xy.shape[0]]
    open_place = ~model.valid[place] | (use[place] < params.least)
    wanted = value > params.threshold
    # Places run from the least useful one, pixels from the worst one.
    fits = open_place & wanted
    new_label = label[xy[:, 1], xy[:, 0]].astype(dtype)

    def put(old: Array, new: Array | float | bool) -> Array:
        keep = fits.reshape((-1,) + (1,) * (old.ndim - 1))
        return old.at[place].set(jnp.where(keep, jnp.asarray(new).astype(old.dtype), old[place]))

    def renewed(old: DepthModel) -> DepthModel:
        return DepthModel(
            put(old.disparity, new_label),
            put(old.xy, xy),
            put(old.log_weight, 0.0),
            old.roughness,
            put(old.valid, True),
        )

    recycled = jnp.sum(fits & model.valid[place])
    trust = objective.trust
    error = put(trust.error, jnp.asarray(jnp.inf).astype(trust.error.dtype))
    trust = eqx.tree_at(lambda t: (t.origin, t.error), trust, (renewed(trust.origin), error))
    objective = eqx.tree_at(lambda o: o.trust, objective, trust)
    model = renewed(model)

    def loss_of(parts: tuple[Array, Array, Array, Array]) -> Array:
        return objective(with_parts(model, parts), state.disparity, key=state.key)[0]

    gradient = jax.grad(loss_of)(parts_of(model))
    gradient = jax.tree.map(lambda leaf: jnp.where(jnp.isfinite(leaf), leaf, 0), gradient)

    def started(old: tuple[Array, ...], new: tuple[Array, ...]) -> tuple[Array, ...]:
        points = (put(a, b[place]) for a, b in zip(old[1:], new[1:], strict=True))
        return old[0], *points

    first, second = settled_moments(state.moments, gradient)
    state = eqx.tree_at(
        lambda s: (s.model, s.moments.mu, s.moments.nu, s.best_loss),
        state,
        (
            model,
            started(state.moments.mu, first),
            started(state.moments.nu, second),
            jnp.full_like(state.best_loss, jnp.inf),
        ),
    )
    return Grown(state, objective, jnp.sum(fits), recycled, jnp.sum(wanted & ~open_place))


def optimise_growing(
    state: State,
    routine: Routine,
    objective: Supervised,
    params: GrowParams,
    *,
    rounds: int = 9,
    until: float = 0.6,
    count: int | None = None,
    after_chunk: Callable[[State, History], State | None] | None = None,
    after_growth: Callable[[Grown], None] | None = None,
) -> tuple[State, History]:
    """`optimise` towards a known map, with points moved or added where it is wrong, in rounds.

    A gradient moves a point by a few pixels, as far as its label is seen. Where no point was
    detected at all (flat surfaces, slivers between objects, the holes of a perforated panel) none
    arrives, while points that nearer ones hide do nothing elsewhere. Every round moves such points
    to the worst pixels; their number stays the same unless the model has free places
    (`with_capacity`), which are filled first.

    Args:
        state: from `begin` or from a file; iterations that it has done are skipped.
        routine: what every iteration does.
        objective: the known map, its rendering, and limits.
        params: see `GrowParams`; the defaults were chosen on the synthetic scenes "textureless"
            and "thin".
        rounds: about how many, evenly spaced.
        until: share of the iterations after which points stay, so that all can settle, in [0, 1].
        count: most points per round; by default a fiftieth of the pixels, or what fills the free
            places in time.
        after_chunk: as of `optimise`, before the points of a round.
        after_growth: called with what a round did.

    Returns:
        The last state and the history of the iterations that were done.

    Raises:
        ValueError: `rounds` or `count` is below 1, or `until` is outside [0, 1].

    Source:
        Named as future work in thesis 8.1.1; `experiments/figure_7_10.py` measures it.
    """
    if rounds < 1 or (count is not None and count < 1):
        raise ValueError(f"`rounds` and `count` must be at least 1, got {rounds} and {count}.")
    if not 0 <= until <= 1:
        raise ValueError(f"`until` must be a share from 0 to 1, got {until}.")
    # After the last iteration nothing would say whether new points are any good.
    last = min(round(until * routine.length), routine.length - 1)
    chunk = max(-(-last // rounds), 1) if last > 0 else max(routine.length, 1)
    if count is None:
        free = state.model.valid.size - int(jnp.sum(state.model.valid))
        count = max(objective.truth.size // 50, -(-free // rounds), 1)

    def look(state: State, history: History) -> tuple[State, Objective]:
        nonlocal objective
        if after_chunk is not None:
            state = after_chunk(state, history) or state
        if int(state.iteration) <= last:
            wrong = jnp.where(objective.known, jnp.abs(state.disparity - objective.truth), 0)
            grown = grow(state, objective, wrong, objective.truth, params, count=count)
            if after_growth is not None:
                after_growth(grown)
            assert isinstance(grown.objective, Supervised)
            state, objective = grown.state, grown.objective
        return state, objective

    return optimise(state, routine, objective, chunk=chunk, after_chunk=look)
