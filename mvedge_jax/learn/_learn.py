"""The loop: minibatches of scenes, steps of Optax, validation, checkpoints."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import PRNGKeyArray

from mvedge_jax._paths import value_at
from mvedge_jax.lightfield import LightField

from ._choice import Choice, Values, chosen
from ._loss import Loss, RobustLoss
from ._scenes import Scenes, losses, losses_and_slope
from ._state import State


class Progress(NamedTuple):
    """How far a run is.

    Attributes:
        step: steps that are done.
        steps: steps that there are at most.
        loss: mean of the last minibatch.
        validation: mean of the last check; NaN before the first one.
    """

    step: int
    steps: int
    loss: float
    validation: float


class Learned(NamedTuple):
    """What learning ended at.

    Attributes:
        model: with the best values: those of the lowest validation loss, or the last ones.
        start: the model at the start.
        values: the learned values, by path.
        losses: mean loss of the minibatch of every step.
        validation: pairs of a step and the mean loss of the validation scenes after it.
        best_step: the step after which the values of `model` were reached.
    """

    model: Any
    start: Any
    values: Values
    losses: np.ndarray
    validation: list[tuple[int, float]]
    best_step: int

    def factors(self) -> dict[str, float]:
        """By which factor single positive numbers changed, by path."""
        found = {}
        for path, value in self.values.items():
            before = value_at(self.start, path)
            if np.ndim(value) == 0 and float(before) > 0 and float(value) > 0:
                found[path] = float(value) / float(before)
        return found


def learn(
    model: Any,
    what: Sequence[str] | Callable[[str], bool],
    scenes: Sequence[LightField],
    *,
    validation: Sequence[LightField] | None = None,
    loss: Loss | None = None,
    optimizer: optax.GradientTransformation | None = None,
    steps: int = 200,
    batch: int = 2,
    prior: float = 0.0,
    limit: float = float("inf"),
    check_every: int = 10,
    patience: int | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = True,
    progress: Callable[[Progress], None] | None = None,
    key: PRNGKeyArray,
) -> Learned:
    """Learns leaves of a model by gradient, in minibatches of scenes.

    Positive numbers that the model declares are moved by their logarithm, other arrays (weights of
    networks, taps of filters) as they are. Leaves that are not chosen stay untouched.

    Args:
        model: such as an `EdgeDepth`: called with a light field without truth and `key`.
        what: paths of numbers, arrays or parts, or a function of a path; see `chosen`.
        scenes: light fields of equal shapes, with truth unless the loss needs none; read when they
            are drawn. `of_one_range` gives them one disparity range, for which the model is made.
        validation: scenes that are only measured; the best values on them are kept.
        loss: of what the model returns and the light field, hashable; `RobustLoss()` by default.
        optimizer: of Optax; Adam by default, whose rate falls from .02 to 0 along a cosine.
        steps: minibatches.
        batch: scenes of a step. They go through one program, a few side by side (`batched`).
        prior: pull back to the start, as a factor of the change of a number's logarithm.
        limit: of the norm of the gradient of a scene; longer ones are shortened.
        check_every: steps between validations, and between checkpoints.
        patience: validations without a better one after which learning stops; None for never.
        checkpoint: a folder that the state is kept in, to go on from after an interruption.
        resume: go on from the state that is there; otherwise it is overwritten.
        progress: called after each step.
        key: of the order of the scenes, and of models that draw.

    Returns:
        The model, its learned values and the curves.

    Raises:
        ValueError: nothing can be learned at a path, scenes differ in kind or exceed the model's
            range, an option is out of range, or the checkpoint is of another run.
        FloatingPointError: a loss or a gradient is not finite; naming step and scene.
    """
    choice = chosen(model, what)
    train = Scenes("scenes", scenes)
    held = None if validation is None else Scenes("validation", validation, train.like())
    _check_options(steps, batch, len(train), check_every, patience, prior, limit)
    for each in (train, held):
        if each is not None:
            each.check_covered(model)
    chain = optimizer or optax.adam(optax.cosine_decay_schedule(0.02, steps))
    run = _Run(model, choice, train, held, loss or RobustLoss(), chain, batch, prior, limit, key)
    first = choice.start(model)
    checks = 0 if held is None else -(-steps // check_every) + 1
    state = State.begin(first, run.moments(first), steps, checks)
    folder = None if checkpoint is None else Path(checkpoint)
    settings = run.settings(steps, check_every)
    if folder is not None and resume:
        state = state.resumed(folder, settings)
    if held is not None and np.isnan(state.validation[0]):
        state = _checked(state, run.validated(state.values), 0)
    while int(state.step) < steps and not _exhausted(state, patience, check_every):
        state = run.step(state, first)
        done = int(state.step)
        if done % check_every == 0 or done == steps:
            if held is None:
                state = _better(state)
            else:
                state = _checked(state, run.validated(state.values), -(-done // check_every))
            if folder is not None:
                state.save(folder, settings)
        if progress is not None:
            progress(Progress(done, steps, float(state.losses[done - 1]), _last(state.validation)))
    return _learned(model, choice, state, check_every, steps)


class _Run(NamedTuple):
    """What stays the same from step to step."""

    model: Any
    choice: Choice
    scenes: Scenes
    held: Scenes | None
    loss: Loss
    optimizer: optax.GradientTransformation
    batch: int
    prior: float
    limit: float
    key: PRNGKeyArray

    def moments(self, values: Values) -> Any:
        """The optimizer's state before the first step."""
        return self.optimizer.init(values)

    def step(self, state: State, first: Values) -> State:
        """One minibatch, one step."""
        number = int(state.step)
        drawn = self.scenes.drawn(number, self.batch, self._seed())
        limit = jnp.asarray(self.limit, jnp.result_type(float))
        found, slope = losses_and_slope(
            self.scenes.stack(drawn),
            state.values,
            self.model,
            self.key,
            limit,
            self.choice,
            self.loss,
        )
        self._check_finite(np.asarray(found), slope, drawn, number + 1)
        slope = {p: g + self.prior * (state.values[p] - first[p]) for p, g in slope.items()}
        # Optax divides by an integer count.
        with jax.numpy_dtype_promotion("standard"):
            updates, moments = self.optimizer.update(slope, state.moments, state.values)
            values = optax.apply_updates(state.values, updates)
        curve = state.losses.copy()
        curve[number] = np.asarray(found).mean()
        return eqx.tree_at(
            lambda s: (s.step, s.values, s.moments, s.losses),
            state,
            (np.asarray(number + 1, np.int64), values, moments, curve),
        )

    def validated(self, values: Values) -> float:
        """Mean loss over the validation scenes."""
        assert self.held is not None
        found: list[float] = []
        for start in range(0, len(self.held), self.batch):
            # The last group is filled up with its last scene, so that one program serves all.
            places = [min(start + k, len(self.held) - 1) for k in range(self.batch)]
            stacked = self.held.stack(places)
            part = losses(stacked, values, self.model, self.key, self.choice, self.loss)
            found += np.asarray(part)[: len(self.held) - start].tolist()
        mean = float(np.mean(found))
        if not np.isfinite(mean):
            place = int(np.argmin(np.isfinite(found)))
            raise FloatingPointError(
                f"the loss of validation scene {place} ({self.held.fields[place].name}) is "
                f"{found[place]}; a number may have left the range in which the model works."
            )
        return mean

    def settings(self, steps: int, check_every: int) -> dict[str, Any]:
        """What a checkpoint must share with the run that goes on from it."""
        return {
            "what": list(self.choice.paths),
            "steps": steps,
            "batch": self.batch,
            "check_every": check_every,
            "scenes": len(self.scenes),
            "validation": 0 if self.held is None else len(self.held),
            "prior": self.prior,
            "limit": str(self.limit),
            "key": self._seed(),
        }

    def _seed(self) -> list[int]:
        return np.ravel(jax.random.key_data(self.key)).tolist()

    def _check_finite(
        self, found: np.ndarray, slope: Values, drawn: list[int], number: int
    ) -> None:
        advice = "a smaller learning rate, a `prior` or a `limit` keeps numbers nearer to the start"
        for place, value in zip(drawn, found.tolist(), strict=True):
            if not np.isfinite(value):
                name = self.scenes.fields[place].name
                raise FloatingPointError(
                    f"step {number}: the loss of `scenes[{place}]` ({name}) is {value}; {advice}."
                )
        wrong = [path for path, leaf in slope.items() if not np.isfinite(np.asarray(leaf)).all()]
        if wrong:
            names = [self.scenes.fields[place].name for place in drawn]
            more = f" and {len(wrong) - 1} more" if wrong[1:] else ""
            raise FloatingPointError(
                f"step {number}: the gradient by `{wrong[0]}`{more} is not finite on {names}; "
                f"{advice}."
            )


def _check_options(
    steps: int,
    batch: int,
    scenes: int,
    check_every: int,
    patience: int | None,
    prior: float,
    limit: float,
) -> None:
    whole = {"steps": steps, "batch": batch, "check_every": check_every, "patience": patience}
    for name, value in whole.items():
        if value is not None and value < 1:
            raise ValueError(f"`{name}` must be at least 1, got {value}.")
    if batch > scenes:
        raise ValueError(f"`batch` must be at most the number of scenes, {scenes}, got {batch}.")
    if not (np.isfinite(prior) and prior >= 0):
        raise ValueError(f"`prior` must be finite and not negative, got {prior}.")
    if not limit > 0:
        raise ValueError(f"`limit` must be positive, got {limit}.")


def _checked(state: State, value: float, check: int) -> State:
    """The state after a validation."""
    curve = state.validation.copy()
    curve[check] = value
    state = eqx.tree_at(lambda s: s.validation, state, curve)
    return _better(state) if value <= np.nanmin(curve) else state


def _better(state: State) -> State:
    """The state whose present values are the best."""
    return eqx.tree_at(lambda s: (s.best, s.best_step), state, (state.values, state.step))


def _exhausted(state: State, patience: int | None, check_every: int) -> bool:
    """Whether too many validations were no better."""
    if patience is None or not len(state.validation):
        return False
    return int(state.step) - int(state.best_step) >= patience * check_every


def _last(curve: np.ndarray) -> float:
    known = curve[~np.isnan(curve)]
    return float(known[-1]) if len(known) else float("nan")


def _learned(model: Any, choice: Choice, state: State, check_every: int, steps: int) -> Learned:
    validation = [
        (min(check * check_every, steps), float(value))
        for check, value in enumerate(state.validation)
        if not np.isnan(value)
    ]
    return Learned(
        choice.into(model, state.best),
        model,
        choice.outward(state.best),
        state.losses[: int(state.step)],
        validation,
        int(state.best_step),
    )
