"""What is learned of a model: numbers by their logarithm, other arrays as they are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mvedge_jax._paths import Described, replaced, value_at, walk

Values = dict[str, Array]


@dataclass(frozen=True)
class Choice:
    """Leaves of a model that are learned.

    Attributes:
        paths: of all of them, see `describe`.
        logs: paths of those that are moved by their logarithm, so that they stay positive and a
            step is a percentage: numbers that the model declares, all above 0.
    """

    paths: tuple[str, ...]
    logs: frozenset[str]

    def start(self, model: eqx.Module) -> Values:
        """The coordinates that steps are taken in: logarithms, and values as they are."""
        return {path: self._inward(path, value_at(model, path)) for path in self.paths}

    def into(self, model: Any, coordinates: Values) -> Any:
        """The model with learned leaves, by coordinates as `start` gives them."""
        return replaced(model, self.outward(coordinates))

    def outward(self, coordinates: Values) -> Values:
        """The values that coordinates stand for, by path."""
        return {p: jnp.exp(x) if p in self.logs else x for p, x in coordinates.items()}

    def _inward(self, path: str, value: Array) -> Array:
        return jnp.log(value) if path in self.logs else jnp.asarray(value)


def chosen(model: eqx.Module, what: Sequence[str] | Callable[[str], bool]) -> Choice:
    """Chooses leaves of a model.

    Args:
        model: any.
        what: paths of numbers and arrays, or of parts, which stand for all of theirs; or a function
            of a path. Parts and functions leave out thresholds and numbers at 0.

    Returns:
        The choice.

    Raises:
        ValueError: a path holds no floating-point array, a threshold or 0, or nothing is left.

    Example:
        >>> from mvedge_jax.smoothness import ColorAndDepth
        >>> chosen(ColorAndDepth(), ["color", "depth"]).paths
        ('color', 'depth')
    """
    rows = [row for row in walk(model) if not row.static and eqx.is_inexact_array(row.value)]
    if callable(what):
        kept = [row for row in rows if what(row.path) and _movable(row)]
    else:
        named = dict.fromkeys(path for wish in what for path in _below(model, wish, rows))
        kept = [row for row in rows if row.path in named]
    if not kept:
        raise ValueError(f"`what` must choose a number at least, got {_shown(what)}.")
    logs = frozenset(row.path for row in kept if row.declared)
    return Choice(tuple(row.path for row in kept), logs)


def _below(model: eqx.Module, wish: str, rows: Sequence[Described]) -> list[str]:
    """Paths of what is at a path: itself, or the leaves of the part."""
    value = value_at(model, wish)
    exact = [row for row in rows if row.path == wish]
    for row in exact:
        if row.threshold:
            raise ValueError(f"`{wish}` is a threshold: its derivative is 0, it can't be learned.")
        if not _movable(row):
            raise ValueError(f"`{wish}` must be positive to be learned, got {_number(row.value)}.")
    below = [r.path for r in rows if r.path.startswith((f"{wish}.", f"{wish}[")) and _movable(r)]
    if not exact and not below:
        raise ValueError(f"`{wish}` holds {value!r}; only numbers and arrays can be learned.")
    return [row.path for row in exact] + below


def _movable(row: Described) -> bool:
    return not row.threshold and (not row.declared or bool((np.asarray(row.value) > 0).all()))


def _number(value: Any) -> str:
    return f"{float(np.min(value)):g}"


def _shown(what: Any) -> str:
    return "a function that chooses none" if callable(what) else repr(list(what))
