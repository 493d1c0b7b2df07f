"""The search space: numbers and static fields of `EdgeDepth`, by path."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mvedge_jax._paths import value_at
from mvedge_jax._settings import Setting, is_number, with_settings
from mvedge_jax.depth import EdgeDepth


@dataclass(frozen=True)
class Interval:
    """The interval of a number.

    Attributes:
        low: the least value.
        high: the largest.
        log: uniform in the logarithm, for weights and scales; `low` must be positive.
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
    """The search space of a sweep; paths are those of `describe(model)`.

    Attributes:
        numbers: traced numbers of the model by path, such as `"smoothness.color"`. Settings that
            differ in them alone share a program.
        choices: static fields by path, with the values to try, such as `{"measurement.views":
            ("crosshair", "all")}`. Each combination is a program of its own.

    Raises:
        ValueError: nothing is varied, or a choice has no values.

    Example:
        >>> space = Space({"smoothness.color": Interval(0.1, 1.0)}, {"refine.solves": (1, 2)})
        >>> space.names
        ('smoothness.color',)
    """

    numbers: Mapping[str, Interval] = field(default_factory=dict)
    choices: Mapping[str, tuple] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.numbers and not self.choices:
            raise ValueError("a sweep must vary at least one number or choice, got none.")
        for name, values in self.choices.items():
            if not values:
                raise ValueError(f"choice {name!r} must have at least one value, got none.")

    @property
    def names(self) -> tuple[str, ...]:
        """Paths of the numbers, in order."""
        return tuple(self.numbers)

    def check(self, model: EdgeDepth) -> None:
        """Checks that paths and values fit a model of the preset that is swept.

        A ValueError names a path that is not that of a number or of a static field of the model, or
        a value of another kind or out of range.
        """
        for name, interval in self.numbers.items():
            if not is_number(value_at(model, name)):
                raise ValueError(
                    f"`{name}` is not a number, as an interval needs; static fields are choices."
                )
            for end in (interval.low, interval.high):
                with_settings(model, {name: float(end)})
        for name, values in self.choices.items():
            if is_number(value_at(model, name)):
                raise ValueError(f"`{name}` is a number, not a static field; give it an interval.")
            for value in values:
                with_settings(model, {name: value})

    def start(self, model: EdgeDepth) -> dict[str, Setting] | None:
        """The first setting, by path: the model's numbers and the first value of each choice.

        None if a number of the model is not within its interval.
        """
        numbers = {}
        for name, interval in self.numbers.items():
            value = np.asarray(value_at(model, name))
            # A default on a bound may differ from it by rounding.
            low, high = (value.dtype.type(end) for end in (interval.low, interval.high))
            if not low <= value <= high:
                return None
            numbers[name] = min(max(float(value), interval.low), interval.high)
        return {**numbers, **{name: values[0] for name, values in self.choices.items()}}
