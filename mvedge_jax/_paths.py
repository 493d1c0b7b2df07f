"""Numbers and static fields of a tree of modules, by path."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax

_Module = TypeVar("_Module", bound=eqx.Module)


class Described(NamedTuple):
    """A number or a static field of a module.

    Attributes:
        path: names of fields, joined by dots.
        value: a number, an array, or what a static field holds.
        unit: what it is measured in; empty for static fields and arrays without one.
        threshold: whether it only selects, so that its derivative is 0.
        static: whether another value is another program.
    """

    path: str
    value: Any
    unit: str
    threshold: bool
    static: bool

    def __str__(self) -> str:
        return f"{self.path} = {_shown(self.value)} {self.unit}".rstrip()


def describe(module: eqx.Module) -> tuple[Described, ...]:
    """All numbers and static fields of a module, with units.

    Args:
        module: such as an `EdgeDepth`.

    Returns:
        In the order of the fields. Arrays inside of tuples are left out.

    Example:
        >>> from mvedge_jax.smoothness import ColorAndDepth
        >>> print(describe(ColorAndDepth())[0])
        color = 0.3 CIELAB
    """
    return tuple(_walk(module, ""))


def described(module: eqx.Module) -> list[str]:
    """One line per number, such as `refine.precision = 0.005 px`; for people.

    Args:
        module: any.

    Returns:
        Lines; traced values and arrays show their types.
    """
    return [str(row) for row in describe(module) if not row.static]


def value_at(module: Any, path: str) -> Any:
    """The number, static field or part at a path.

    Args:
        module: any.
        path: names of fields, joined by dots.

    Returns:
        What is there.

    Raises:
        ValueError: nothing is, naming what there is instead.
    """
    value = module
    for name in path.split("."):
        names = [field.name for field in _fields(value)]
        if name not in names:
            known = f"the fields of `{type(value).__name__}` are {names}" if names else "no part"
            raise ValueError(f"`{path}` is no path of `{type(module).__name__}`: {known}.")
        value = getattr(value, name)
    return value


def replaced(module: _Module, choices: Mapping[str, Any]) -> _Module:
    """A module with other numbers, static fields or parts.

    Args:
        module: any.
        choices: by path; a number takes Python numbers, arrays and traced values.

    Returns:
        The new module; checks of ranges run as at its construction.

    Raises:
        ValueError: a path is none of the module's, or a value is out of range.

    Example:
        >>> from mvedge_jax.smoothness import ColorAndDepth
        >>> float(replaced(ColorAndDepth(), {"color": 2.0}).color)
        2.0
    """
    for path, value in choices.items():
        value_at(module, path)
        module = _with(module, path.split("."), value)
    return module


def _with(module: Any, names: list[str], value: Any) -> Any:
    name, *rest = names
    new = _with(getattr(module, name), rest, value) if rest else value
    return dataclasses.replace(module, **{name: new})


def _fields(module: Any) -> tuple[Any, ...]:
    if not dataclasses.is_dataclass(module) or isinstance(module, type):
        return ()
    return dataclasses.fields(module)


def _walk(module: Any, prefix: str) -> Iterator[Described]:
    for field in _fields(module):
        value, path = getattr(module, field.name), prefix + field.name
        static = bool(field.metadata.get("static", False))
        if not static and isinstance(value, eqx.Module):
            yield from _walk(value, path + ".")
        elif static or eqx.is_array(value) or isinstance(value, int | float):
            threshold = bool(field.metadata.get("threshold", False))
            yield Described(path, value, field.metadata.get("unit", ""), threshold, static)


def _shown(value: Any) -> str:
    """A number as such; what is traced, or an array, by its type."""
    if eqx.is_array(value) and value.ndim == 0:
        try:
            return f"{float(value):.6g}"
        except jax.errors.ConcretizationTypeError:
            pass
    return eqx.tree_pformat(value)
