"""Optimization of the model by gradient descent: a jitted loop, in pieces with host hooks."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from mvedge_jax._compiler import lean_jit

from .._host import warn_of_cuts
from .._model import DepthModel
from ..objectives import Objective
from ._routine import Routine
from ._state import ADAM, State, parts_of, with_parts


class History(NamedTuple):
    """Loss and gradient of every iteration.

    Attributes:
        loss: loss before the step.
        gradient: norm of the gradient of Q, Z, R and xy.
    """

    loss: Float[Array, "i"]
    gradient: Float[Array, "i 4"]


class Plan(NamedTuple):
    """The schedule of a strategy, on the host.

    Attributes:
        piece: iterations between two calls; a whole number of pieces compiles only once.
        last: the last iteration after which points change.
        most: largest number of points that change at a time.
    """

    piece: int
    last: int = -1
    most: int = 0


class Grown(NamedTuple):
    """The result of adding points.

    Attributes:
        state: state with the new points; the moments of Adam are those of their first gradient.
        objective: objective with a `trust` that includes the new points.
        added: number of new points.
        recycled: how many of them replaced an inactive point.
        refused: number of points without a slot.
    """

    state: State
    objective: Objective
    added: Int[Array, ""]
    recycled: Int[Array, ""]
    refused: Int[Array, ""]


class Strategy(eqx.Module):
    """Changes the number and the positions of points where gradients cannot; abstract.

    `prepare` is called once for a model, `plan` before the first iteration, `after_piece` between
    any two pieces of iterations, all on the host.
    """

    @abc.abstractmethod
    def prepare(self, model: DepthModel) -> DepthModel:
        """The model with the free slots that the strategy will fill."""

    @abc.abstractmethod
    def plan(self, state: State, routine: Routine, objective: Objective) -> Plan:
        """The schedule of changes."""

    @abc.abstractmethod
    def after_piece(self, plan: Plan, state: State, objective: Objective) -> Grown | None:
        """The new state and objective, or None if no change is due."""


class FixedPoints(Strategy):
    """Points move by their gradients alone, and none are added.

    Attributes:
        piece: iterations that are compiled as one, between two reports of progress; by default a
            quarter of all.

    Raises:
        ValueError: `piece` is below 1.
    """

    piece: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if self.piece is not None and self.piece < 1:
            raise ValueError(f"`piece` must be at least 1 iteration, got {self.piece}.")

    def prepare(self, model: DepthModel) -> DepthModel:
        """The unchanged model."""
        return model

    def plan(self, state: State, routine: Routine, objective: Objective) -> Plan:
        """A schedule without changes."""
        return Plan(max(routine.length // 4, 1) if self.piece is None else self.piece)

    def after_piece(self, plan: Plan, state: State, objective: Objective) -> None:
        """No change."""


class Progress(NamedTuple):
    """Progress of an optimization.

    Attributes:
        iteration: number of finished iterations.
        iterations: total number of iterations.
        loss: loss of the last iteration, before its step.
        state: state after the last iteration and after `grown`.
        grown: result of a strategy that changed points after this piece, else None.
    """

    iteration: int
    iterations: int
    loss: float
    state: State
    grown: Grown | None


@lean_jit
def advance(state: State, routine: Routine, objective: Objective) -> tuple[State, History]:
    """Runs all iterations of `routine` in one compiled loop.

    A step that is not finite is skipped. The best parameters are those with the lowest loss,
    judged before each step.

    Args:
        state: the current state.
        routine: what every iteration does.
        objective: what is minimized.

    Returns:
        The new state and the history of these iterations.
    """

    def step(state: State, row: tuple[Array, Array]) -> tuple[State, History]:
        rates, restart = row
        key, draw = jax.random.split(state.key)

        def loss_of(parts: tuple[Array, Array, Array, Array]) -> tuple[Array, Array]:
            return objective(with_parts(state.model, parts), state.disparity, key=draw)

        parts = parts_of(state.model)
        (loss, disparity), gradient = jax.value_and_grad(loss_of, has_aux=True)(parts)
        fresh = ADAM.init(parts)
        moments = jax.tree.map(lambda old, new: jnp.where(restart, new, old), state.moments, fresh)
        updates: Any
        # Optax raises a Python number to the power of its integer step count.
        with jax.numpy_dtype_promotion("standard"):
            updates, moments = ADAM.update(gradient, moments)
        sound = jnp.isfinite(loss)
        for leaf in gradient:
            sound = sound & jnp.all(jnp.isfinite(leaf))
        moved = tuple(
            part - jnp.where(sound, rate.astype(part.dtype) * update, 0)
            for part, update, rate in zip(parts, updates, rates, strict=True)
        )
        moments = jax.tree.map(lambda new, old: jnp.where(sound, new, old), moments, state.moments)
        better = sound & (loss < state.best_loss)
        best = jax.tree.map(lambda a, b: jnp.where(better, a, b), state.model, state.best)
        model = objective.project(with_parts(state.model, (moved[0], moved[1], moved[2], moved[3])))
        norms = jnp.stack([jnp.sqrt(jnp.sum(leaf**2)) for leaf in gradient])
        new = State(
            model,
            moments,
            jnp.where(jnp.isfinite(disparity), disparity, state.disparity),
            best,
            jnp.where(better, loss, state.best_loss),
            state.iteration + 1,
            key,
        )
        return new, History(loss, norms)

    return jax.lax.scan(step, state, (routine.rates, routine.restart))


def optimize(
    state: State,
    routine: Routine,
    objective: Objective,
    *,
    strategy: Strategy | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> tuple[State, History]:
    """Runs a routine in compiled pieces, with hooks on the host between them.

    Args:
        state: from `begin`, or from a file; finished iterations of `routine` are skipped.
        routine: what every iteration does.
        objective: what is minimized.
        strategy: adds or moves points between pieces; by default `FixedPoints()`.
        progress: called after every piece with a `Progress`.

    Returns:
        The last state and the history of its iterations. Warns if the objective's `renderer` cuts
        points off.
    """
    warn_of_cuts(state.model, objective)
    strategy = FixedPoints() if strategy is None else strategy
    plan = strategy.plan(state, routine, objective)
    pieces = []
    for done in range(int(state.iteration), routine.length, plan.piece):
        state, history = advance(state, routine.part(done, done + plan.piece), objective)
        pieces.append(history)
        grown = strategy.after_piece(plan, state, objective)
        if grown is not None:
            state, objective = grown.state, grown.objective
        if progress is not None:
            at, loss = int(state.iteration), float(history.loss[-1])
            progress(Progress(at, routine.length, loss, state, grown))
    if not pieces:
        dtype = state.best_loss.dtype
        return state, History(jnp.zeros(0, dtype), jnp.zeros((0, 4), dtype))
    return state, jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *pieces)
