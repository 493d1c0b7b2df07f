"""Optimisation of the model by gradient descent: a jitted loop, saved and resumed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from ._model import DepthModel
from ._routine import Routine


@runtime_checkable
class Objective(Protocol):
    """What is minimised: a pytree that is called with the model."""

    def __call__(
        self, model: DepthModel, start: Float[Array, "y x"], *, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Float[Array, "y x"]]:
        """Loss of `model` and the map it renders; `start` is the previous map."""
        ...

    def project(self, model: DepthModel) -> DepthModel:
        """The nearest model that is allowed."""
        ...


class State(eqx.Module):
    """Everything that the optimisation carries from one iteration to the next.

    Attributes:
        model: the current parameters.
        moments: of Adam.
        disparity: the last rendered map.
        best: the parameters with the lowest loss so far.
        best_loss: that loss.
        iteration: how many iterations were done.
        key: draws views and noise.
    """

    model: DepthModel
    moments: Any
    disparity: Float[Array, "y x"]
    best: DepthModel
    best_loss: Float[Array, ""]
    iteration: Int[Array, ""]
    key: PRNGKeyArray


class History(NamedTuple):
    """What happened per iteration.

    Attributes:
        loss: before the step.
        gradient: norm of the gradient of Q, Z, R and xy.
    """

    loss: Float[Array, "i"]
    gradient: Float[Array, "i 4"]


# How much of its two moments Adam keeps per iteration: Optax' defaults.
_KEPT = (0.9, 0.999)
_ADAM = optax.scale_by_adam(*_KEPT)


def parts_of(model: DepthModel) -> tuple[Array, Array, Array, Array]:
    """Q, Z, R, xy: the order of the thesis' routine."""
    return model.roughness, model.disparity, model.log_weight, model.xy


def with_parts(model: DepthModel, parts: tuple[Array, Array, Array, Array]) -> DepthModel:
    """The model with Q, Z, R and xy replaced."""
    roughness, disparity, log_weight, xy = parts
    return DepthModel(disparity, xy, log_weight, roughness, model.valid)


def settled_moments(
    moments: Any, gradient: tuple[Array, Array, Array, Array]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Both moments as they would be if every gradient so far had been this one.

    A parameter that is new must not start from zero moments: the correction for that fades with
    the iterations of the whole state, and without it steps are three to six times the learning
    rate for a hundred iterations.

    Args:
        moments: of Adam; only the number of its iterations is used.
        gradient: of Q, Z, R, xy.

    Returns:
        First and second moments of Q, Z, R, xy.
    """
    first, second = (
        tuple(
            (1 - jnp.asarray(kept, leaf.dtype) ** moments.count.astype(leaf.dtype)) * leaf**power
            for leaf in gradient
        )
        for power, kept in enumerate(_KEPT, 1)
    )
    return first, second


def begin(model: DepthModel, disparity: Float[Array, "y x"], *, key: PRNGKeyArray) -> State:
    """The state before the first iteration.

    Args:
        model: initial parameters.
        disparity: a map near the one that `model` renders, where the first solve starts.
        key: draws views and noise.

    Returns:
        The state.
    """
    infinite = jnp.full((), jnp.inf, model.disparity.dtype)
    zero = jnp.zeros((), jnp.int32)
    return State(model, _ADAM.init(parts_of(model)), disparity, model, infinite, zero, key)


@eqx.filter_jit
def advance(state: State, routine: Routine, objective: Objective) -> tuple[State, History]:
    """Does as many iterations as `routine` has, as one compiled loop.

    A step that is not finite is skipped. The best parameters are those with the lowest loss,
    judged before each step.

    Args:
        state: where to go on.
        routine: what every iteration does.
        objective: what is minimised.

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
        fresh = _ADAM.init(parts)
        moments = jax.tree.map(lambda old, new: jnp.where(restart, new, old), state.moments, fresh)
        updates: Any
        # Optax raises a Python number to the power of its integer step count.
        with jax.numpy_dtype_promotion("standard"):
            updates, moments = _ADAM.update(gradient, moments)
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


def optimise(
    state: State,
    routine: Routine,
    objective: Objective,
    *,
    chunk: int = 13,
    after_chunk: Callable[[State, History], State | tuple[State, Objective] | None] | None = None,
) -> tuple[State, History]:
    """Runs a routine in compiled pieces, with the host looking in between.

    Args:
        state: from `begin`, or from a file: iterations of `routine` that it has done are skipped.
        routine: what every iteration does.
        objective: what is minimised.
        chunk: iterations per piece; a whole number of pieces compiles only once.
        after_chunk: called after every piece, for progress, saving, or adding points; may return
            a state to go on with, or a state and an objective.

    Returns:
        The last state and the history of the iterations that were done.

    Raises:
        ValueError: `chunk` is below 1.
    """
    if chunk < 1:
        raise ValueError(f"`chunk` must be at least 1 iteration, got {chunk}.")
    pieces = []
    for begin_at in range(int(state.iteration), routine.length, chunk):
        state, history = advance(state, routine.part(begin_at, begin_at + chunk), objective)
        pieces.append(history)
        if after_chunk is not None:
            changed = after_chunk(state, history)
            if isinstance(changed, State):
                state = changed
            elif changed is not None:
                state, objective = changed
    if not pieces:
        dtype = state.best_loss.dtype
        return state, History(jnp.zeros(0, dtype), jnp.zeros((0, 4), dtype))
    return state, jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *pieces)


def save_state(path: str | Path, state: State) -> None:
    """Writes a state to a file, to go on from later.

    Args:
        path: the file to write.
        state: the state.
    """
    eqx.tree_serialise_leaves(path, _raw_key(state))


def load_state(path: str | Path, like: State) -> State:
    """Reads a state that `save_state` wrote.

    Args:
        path: the file.
        like: a state of the same capacity and image size, as `begin` makes it.

    Returns:
        The state.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds a state of another size.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no saved state at {path}.")
    try:
        raw = eqx.tree_deserialise_leaves(path, _raw_key(like))
    except (RuntimeError, EOFError, ValueError) as error:
        raise ValueError(
            f"{path} does not hold a state of {like.model.valid.size} points and an image of "
            f"{like.model.roughness.shape[0]}x{like.model.roughness.shape[1]} pixels."
        ) from error
    return eqx.tree_at(lambda s: s.key, raw, jax.random.wrap_key_data(raw.key))


def _raw_key(state: State) -> State:
    return eqx.tree_at(lambda s: s.key, state, jax.random.key_data(state.key))
