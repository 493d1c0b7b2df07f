"""State of the optimization (parameters, Adam's moments, best model), and its file."""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from mvedge_jax._params import accepts_numpy

from .._model import DepthModel

# Decay rates of Adam's two moments: Optax' defaults.
_KEPT = (0.9, 0.999)
# Length in bytes of the header line of a saved state.
_LONGEST_HEADER = 4096
ADAM = optax.scale_by_adam(*_KEPT)


class State(eqx.Module):
    """Everything that the optimization carries from one iteration to the next.

    Attributes:
        model: the current parameters.
        moments: of Adam.
        disparity: the last rendered map.
        best: the parameters with the lowest loss so far.
        best_loss: that loss.
        iteration: number of finished iterations.
        key: draws views and noise.
    """

    model: DepthModel
    moments: Any
    disparity: Float[Array, "y x"]
    best: DepthModel
    best_loss: Float[Array, ""]
    iteration: Int[Array, ""]
    key: PRNGKeyArray

    def save(self, path: str | Path) -> None:
        """Writes a state to a file, to resume later."""
        points, shape, dtype = _size(self.model)
        header = json.dumps({"points": points, "shape": shape, "dtype": dtype})
        with Path(path).open("wb") as file:
            file.write(header.encode() + b"\n")
            eqx.tree_serialise_leaves(file, _raw_key(self))

    @staticmethod
    def load(path: str | Path) -> "State":
        """Reads a state that `save` wrote.

        A FileNotFoundError, or a ValueError if the file is not a saved state or needs a precision
        that is switched off.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"There is no saved state at {path}.")
        try:
            with path.open("rb") as file:
                header = json.loads(file.readline(_LONGEST_HEADER))
                height, width = map(int, header["shape"])
                points = int(header["points"])
                if max(points, height * width) > path.stat().st_size:
                    raise ValueError(f"it claims {points} points and {height}x{width} px")
                like = _empty(points, (height, width), header["dtype"])
                raw = eqx.tree_deserialise_leaves(file, _raw_key(like))
        except (RuntimeError, EOFError, OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"{path} does not hold a whole state of the optimization in the precision of this "
                f"process: {error}"
            ) from error
        return eqx.tree_at(lambda s: s.key, raw, jax.random.wrap_key_data(raw.key))


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
    """Both moments of Adam for Q, Z, R, xy, as if every gradient so far had been `gradient`.

    A new parameter must not start from zero moments: Adam's bias correction fades with the
    iterations of the whole state, and without it steps are three to six times the learning rate
    for a hundred iterations.
    """
    first, second = (
        tuple(
            (1 - jnp.asarray(kept, leaf.dtype) ** moments.count.astype(leaf.dtype)) * leaf**power
            for leaf in gradient
        )
        for power, kept in enumerate(_KEPT, 1)
    )
    return first, second


@accepts_numpy
def begin(model: DepthModel, disparity: Float[Array, "y x"], *, key: PRNGKeyArray) -> State:
    """The state before the first iteration.

    Args:
        model: initial parameters.
        disparity: a map near the one that `model` renders, the start of the first solve.
        key: draws views and noise.

    Returns:
        The state.
    """
    infinite = jnp.full((), jnp.inf, model.disparity.dtype)
    zero = jnp.zeros((), jnp.int32)
    return State(model, ADAM.init(parts_of(model)), disparity, model, infinite, zero, key)


def resumed(begun: State, earlier: State | None) -> State:
    """The state to resume: `earlier` if it fits the model, `begun` if it is None."""
    if earlier is None:
        return begun
    found, expected = (_size(state.model) for state in (earlier, begun))
    if found != expected:
        raise ValueError(
            f"`state` has {_described(*found)}; the start has {_described(*expected)}."
        )
    return earlier


def _size(model: DepthModel) -> tuple[int, tuple[int, int], str]:
    height, width = model.roughness.shape
    return model.valid.size, (height, width), model.disparity.dtype.name


def _described(points: int, shape: tuple[int, int], dtype: str) -> str:
    return f"{points} points and an image of {shape[0]}x{shape[1]} pixels in {dtype}"


def _empty(points: int, shape: tuple[int, int], dtype: str) -> State:
    label, image = jnp.zeros(points, dtype), jnp.zeros(shape, dtype)
    model = DepthModel(label, jnp.zeros((points, 2), dtype), label, image, jnp.zeros(points, bool))
    return begin(model, image, key=jax.random.key(0))


def _raw_key(state: State) -> State:
    return eqx.tree_at(lambda s: s.key, state, jax.random.key_data(state.key))
