"""What is varied: numbers of `Parameters`, and choices of `Sizes`."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args, get_type_hints

import equinox as eqx
import numpy as np

from mvedge_jax.depth import Parameters, Sizes
from mvedge_jax.edges import EdgeSizes

CHOICE = "sizes."


@dataclass(frozen=True)
class Interval:
    """Where a number is looked for.

    Attributes:
        low: the least value.
        high: the largest.
        log: even in the logarithm, which suits weights and scales; `low` is positive then.
    """

    low: float | int
    high: float | int
    log: bool = True

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise ValueError(
                f"an interval must have finite ends in increasing order, got {self.low} and "
                f"{self.high}."
            )
        if self.log and self.low <= 0:
            raise ValueError(f"a logarithmic interval must be positive, got {self.low}.")


@dataclass(frozen=True)
class Space:
    """What a sweep varies.

    Attributes:
        numbers: leaves of `Parameters` by their path, such as `"centre.precision"`. They are
            traced: settings that differ in them alone share a program.
        choices: fields of `Sizes` with the values to try, such as `{"views": ("crosshair",
            "all")}`. Each combination is a program of its own.

    Raises:
        ValueError: a name is not one of `Parameters` or `Sizes`, a choice is none of `Sizes`, or
            nothing is varied.

    Example:
        >>> space = Space({"centre.precision": Interval(0.002, 0.02)}, {"solves": (1, 2)})
        >>> list(space.names)
        ['centre.precision']
    """

    numbers: Mapping[str, Interval] = field(default_factory=dict)
    choices: Mapping[str, tuple] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.numbers and not self.choices:
            raise ValueError("a sweep must vary at least one number or choice, got none.")
        known = number_names(Parameters())
        for name in self.numbers:
            if name not in known:
                raise ValueError(f"{name!r} is not a number of `Parameters`; they are {known}.")
        sizes = [f.name for f in dataclasses.fields(Sizes) if f.name != "edges"]
        for name, values in self.choices.items():
            if name not in sizes:
                raise ValueError(f"{name!r} is not a choice of `Sizes`; they are {sizes}.")
            if not values:
                raise ValueError(f"choice {name!r} must have at least one value, got none.")
            kind = get_type_hints(Sizes)[name]
            for value in values:
                if get_args(kind) and value not in get_args(kind):
                    raise ValueError(f"choice {name!r} must be of {get_args(kind)}, got {value!r}.")
                if kind is int and not isinstance(value, int):
                    raise ValueError(f"choice {name!r} must be a whole number, got {value!r}.")
                least = Sizes(EdgeSizes(0, 3, 1), hypotheses=2, radius=1)
                dataclasses.replace(least, **{name: value})  # raises where it is out of range

    @property
    def names(self) -> tuple[str, ...]:
        """Paths of the numbers, in order."""
        return tuple(self.numbers)

    def start(self, params: Parameters) -> dict[str, Any] | None:
        """The setting of `params` and the first choices; None if it is not within the intervals."""
        numbers = {}
        for name, interval in self.numbers.items():
            value = np.asarray(leaf(params, name))
            # A bound that is the default is so but for the rounding of the latter.
            low, high = (value.dtype.type(end) for end in (interval.low, interval.high))
            if not low <= value <= high:
                return None
            numbers[name] = min(max(float(value), interval.low), interval.high)
        return {**numbers, **{CHOICE + n: values[0] for n, values in self.choices.items()}}


def number_names(params: Parameters) -> list[str]:
    """Paths of all scalar numbers of `params`."""
    names = []

    def walk(module: eqx.Module, prefix: str) -> None:
        for one in dataclasses.fields(module):
            value = getattr(module, one.name)
            if isinstance(value, eqx.Module):
                walk(value, f"{prefix}{one.name}.")
            elif eqx.is_inexact_array(value) and value.ndim == 0:
                names.append(prefix + one.name)

    walk(params, "")
    return names


def leaf(params: Parameters, name: str) -> Any:
    """The number at a path such as `"centre.precision"`."""
    value: Any = params
    for part in name.split("."):
        value = getattr(value, part)
    return value


def with_numbers(params: Parameters, names: tuple[str, ...], values: Any) -> Parameters:
    """`params` with the numbers at some paths replaced; `values[i]` belongs to `names[i]`."""
    if not names:
        return params
    new = [values[i] for i in range(len(names))]
    return eqx.tree_at(lambda p: [leaf(p, name) for name in names], params, new)
