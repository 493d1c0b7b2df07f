"""Settings of a model that people wrote: numbers and static fields by path, checked at once."""

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar, get_args

import equinox as eqx
import jax.numpy as jnp

from ._checks import with_numbers
from ._paths import describe, replaced, value_at
from .depth import EdgeDepth
from .lightfield import LightField

_Module = TypeVar("_Module", bound=eqx.Module)
# What a setting may be; `bool` is an `int` to Python, but not to a reader. None leaves a part out.
Setting = bool | int | float | str | None


def of_preset(preset: str) -> EdgeDepth:
    """A model of a preset before any light field is read, to check settings against.

    It is that of a small light field: its ranges and capacities are of no use elsewhere.

    Raises:
        ValueError: there is no such preset.
    """
    flat = LightField(jnp.full((9, 9, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
    return EdgeDepth.for_light_field(flat, preset=preset)  # pyright: ignore


def with_settings(model: _Module, settings: Mapping[str, Setting]) -> _Module:
    """A model with other numbers and static fields; unlike `replaced`, it takes no parts or arrays.

    Args:
        model: any.
        settings: by path; None leaves out a part that a model may lack, and stands for the word
            "none" where a field holds a word.

    Returns:
        The new model.

    Raises:
        ValueError: a path is not that of a number or a static field, or a value is of another kind
            or out of range.

    Example:
        >>> from mvedge_jax.smoothness import ColorAndDepth
        >>> float(with_settings(ColorAndDepth(), {"color": 2}).color)
        2.0
    """
    for path, value in settings.items():
        now = value_at(model, path)
        if value is None and isinstance(now, str):
            value = "none"  # one of several words, such as those of `refine.sharpen.mode`
        if value is not None or not _may_lack(model, path):
            _check_kind(path, value, now)
        model = replaced(model, {path: value})
    return with_numbers(model)


def is_number(value: Any) -> bool:
    """Whether a value of a model is a traced number, so that another one is no other program."""
    return eqx.is_inexact_array(value) and value.ndim == 0


def _may_lack(model: eqx.Module, path: str) -> bool:
    """Whether there is a part at a path, or none, and the model works without it."""
    before, _, name = path.rpartition(".")
    holder = value_at(model, before) if before else model
    kinds = next((f.type for f in dataclasses.fields(holder) if f.name == name), None)
    optional = type(None) in get_args(kinds)
    return optional and isinstance(getattr(holder, name), eqx.Module | None)


def _check_kind(path: str, value: Any, now: Any) -> None:
    """Refuses what cannot take the place of the value that is there now."""
    if isinstance(now, eqx.Module):
        names = [row.path for row in describe(now)]
        raise ValueError(f"`{path}` is a part, whose numbers and static fields are {names}.")
    if isinstance(now, bool):
        fits, wish = isinstance(value, bool), "true or false"
    elif isinstance(now, str):
        fits, wish = isinstance(value, str), "a word"
    elif isinstance(now, int):
        fits, wish = isinstance(value, int) and not isinstance(value, bool), "a whole number"
    elif isinstance(now, float) or is_number(now):
        fits, wish = isinstance(value, int | float) and not isinstance(value, bool), "a number"
    else:
        held = "None" if now is None else f"a {type(now).__name__}"
        raise ValueError(f"`{path}` holds {held}; only numbers, words, true and false can be set.")
    if not fits:
        raise ValueError(f"`{path}` must be {wish}, got {value!r}.")
