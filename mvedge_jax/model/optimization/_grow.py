"""Relocates inactive points to pixels of large error, and adds new ones there."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast, number

from .._model import (
    DepthModel,
    Renderer,
    opacities,
    splat_model,
    with_capacity,
    without_free_places,
)
from ..objectives import Objective, SelfSupervised, Supervised
from ._optimize import Grown, Plan, Strategy
from ._routine import Routine
from ._state import State, parts_of, settled_moments, with_parts


class Growth(Strategy):
    """Relocates inactive points to pixels of large error, and adds new ones there.

    Gradients move a point by a few pixels and bring none to surfaces without a detected one (flat
    surfaces, slivers, holes), while points hidden by nearer ones are inactive. Every round moves
    such points to the worst pixels. The number of points stays the same unless the model has free
    slots, which are filled first. The error needs a known map, so the objective must be
    `Supervised`. The defaults were chosen on the synthetic scenes "textureless" and "thin".

    Attributes:
        recycle: relocate inactive points; if False, only free slots are filled.
        extra: number of free slots that `prepare` appends.
        least: points that contribute less than this may move, see `usefulness`.
        threshold: largest error of a pixel that needs no new point, px per view step.
        until: share of the iterations after which points are no longer relocated, in [0, 1].
        rounds: approximate number of rounds, evenly spaced.
        count: most points per round; by default a fiftieth of the pixels, or enough to fill the
            free slots in time.

    Raises:
        ValueError: `rounds` or `count` is below 1, `extra` below 0, or `until` outside [0, 1].

    Source: Named as future work in thesis 8.1.1; `experiments/figure_7_10.py` measures it.

    Example:
        >>> Growth(extra=500).rounds
        9
    """

    recycle: bool = eqx.field(static=True, default=True)
    extra: int = eqx.field(static=True, default=0)
    least: Float[Array, ""] = number(0.2)
    threshold: Float[Array, ""] = number(0.01)
    until: Float[Array, ""] = number(0.6)
    rounds: int = eqx.field(static=True, default=9)
    count: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.rounds < 1 or (self.count is not None and self.count < 1):
            raise ValueError(
                f"`rounds` and `count` must be at least 1, got {self.rounds} and {self.count}."
            )
        if self.extra < 0:
            raise ValueError(f"`extra` must not be negative, got {self.extra}.")
        if not 0 <= self.until <= 1:
            raise ValueError(f"`until` must be a share from 0 to 1, got {float(self.until):g}.")

    def prepare(self, model: DepthModel) -> DepthModel:
        """The model with as many slots as points, and `extra` free ones after them."""
        model = without_free_places(model)
        return with_capacity(model, model.valid.size + self.extra)

    def plan(self, state: State, routine: Routine, objective: Objective) -> Plan:
        """Rounds up to `until`; in four pieces without any if no point may change."""
        if not isinstance(objective, Supervised):
            raise ValueError(
                "`Growth` needs a known map, as `Supervised` has it; the objective is "
                f"{type(objective).__name__}."
            )
        if not self.recycle and bool(jnp.all(state.model.valid)):
            return Plan(max(routine.length // 4, 1))
        # New points need iterations after them to be optimized.
        last = min(round(float(self.until) * routine.length), routine.length - 1)
        piece = max(-(-last // self.rounds), 1) if last > 0 else max(routine.length, 1)
        # Counted from the slots that `prepare` made, so that a resumed run does the same.
        count = max(objective.truth.size // 50, -(-self.extra // max(last // piece, 1)), 1)
        return Plan(piece, last, count if self.count is None else self.count)

    def after_piece(self, plan: Plan, state: State, objective: Objective) -> Grown | None:
        """A round, unless all are over."""
        if int(state.iteration) > plan.last:
            return None
        assert isinstance(objective, Supervised)
        wrong = jnp.where(objective.known, jnp.abs(state.disparity - objective.truth), 0)
        return grow(state, objective, wrong, objective.truth, self, count=plan.most)


def usefulness(model: DepthModel, renderer: Renderer) -> Float[Array, "n"]:
    """Data weight that each point contributes to the map, in raster pixels: Σ w λ T.

    A visible point contributes about `exp(-R)` times 1.4; a hidden one contributes hardly anything
    and has hardly any gradient; a free slot has 0.
    """
    weight = jnp.exp(-model.log_weight)
    opacity = opacities(model, renderer)

    def total(weight: Array) -> Array:
        return jnp.sum(splat_model(model, weight, opacity, renderer).weight)

    return jnp.where(model.valid, weight * jax.grad(total)(weight), 0)


def worst_pixels(
    residual: Float[Array, "y x"], count: int, *, block: int = 2
) -> tuple[Int[Array, "n 2"], Float[Array, "n"]]:
    """`(x, y)` of the `count` pixels of largest residual, at most one per block, and the residuals.

    Largest first; there may be fewer blocks than `count`.
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


@lean_jit
def grow(
    state: State,
    objective: Supervised | SelfSupervised,
    residual: Float[Array, "y x"],
    label: Float[Array, "y x"],
    growth: Growth,
    *,
    count: int,
) -> Grown:
    """Puts up to `count` new points where the residual is largest, with the labels there.

    Free slots are used first, then those of the points that contribute least. Nearly all of these
    are hidden by nearer points and receive no gradient; `Renderer.clears` has a measurement. The
    `trust` of the objective is extended by the new points.
    """
    model = state.model
    dtype = model.disparity.dtype
    growth = cast(growth, dtype)
    use = usefulness(model, cast(objective.renderer, dtype))
    xy, value = worst_pixels(residual, min(count, model.valid.size))
    place = jnp.argsort(jnp.where(model.valid, use, -1))[: xy.shape[0]]
    open_place = ~model.valid[place]
    if growth.recycle:
        open_place = open_place | (use[place] < growth.least)
    wanted = value > growth.threshold
    # Slots in order of usefulness, least first; pixels in order of error, largest first.
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
    first, second = settled_moments(state.moments, _gradient(model, state, objective))

    def started(old: tuple[Array, ...], new: tuple[Array, ...]) -> tuple[Array, ...]:
        points = (put(a, b[place]) for a, b in zip(old[1:], new[1:], strict=True))
        return old[0], *points

    moments = started(state.moments.mu, first), started(state.moments.nu, second)
    state = eqx.tree_at(
        lambda s: (s.model, s.moments.mu, s.moments.nu, s.best_loss),
        state,
        # Other points change the loss, so the best loss is reset.
        (model, *moments, jnp.where(jnp.any(fits), jnp.inf, state.best_loss)),
    )
    return Grown(state, objective, jnp.sum(fits), recycled, jnp.sum(wanted & ~open_place))


def _gradient(
    model: DepthModel, state: State, objective: Objective
) -> tuple[Array, Array, Array, Array]:
    """Of Q, Z, R, xy; zero where it is not finite."""

    def loss_of(parts: tuple[Array, Array, Array, Array]) -> Array:
        return objective(with_parts(model, parts), state.disparity, key=state.key)[0]

    gradient = jax.grad(loss_of)(parts_of(model))
    return jax.tree.map(lambda leaf: jnp.where(jnp.isfinite(leaf), leaf, 0), gradient)
