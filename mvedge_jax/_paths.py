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
        path: names of fields, joined by dots, such as `edges.banks[0].taps`.
        value: a number, an array, or what a static field holds.
        unit: what it is measured in; empty for static fields and arrays without one.
        threshold: whether it only selects or stops, so that its derivative is 0.
        static: whether another value is another program.
        declared: whether it is a number that may not be negative, see `_params.number`.
    """

    path: str
    value: Any
    unit: str
    threshold: bool
    static: bool
    declared: bool

    def __str__(self) -> str:
        return f"{self.path} = {_shown(self.value)} {self.unit}".rstrip()


def describe(module: eqx.Module) -> tuple[Described, ...]:
    """All numbers and static fields of a module, with units.

    Args:
        module: such as an `EdgeDepth`.

    Returns:
        In the order of the fields, those of modules in tuples and lists included. Static fields of
        the layers of `equinox.nn` are left out: they repeat the shapes of the arrays.

    Example:
        >>> from mvedge_jax.smoothness import ColorAndDepth
        >>> print(describe(ColorAndDepth())[0])
        color = 0.3 CIELAB
    """
    return tuple(row for row in walk(module) if row.static or _is_number(row.value))


def described(module: eqx.Module) -> list[str]:
    """One line per number, such as `refine.precision = 0.005 px`; for people."""
    return [str(row) for row in describe(module) if not row.static]


def value_at(module: Any, path: str) -> Any:
    """The number, static field or part at a path.

    Args:
        module: any.
        path: names of fields, joined by dots, such as `edges.banks[0].taps`.

    Returns:
        What is there.

    Raises:
        ValueError: nothing is, naming what there is instead.
    """
    value = module
    for name in _names(path):
        parts = {part.path: part.value for part in _parts(value)}
        if name not in parts:
            kind, names = type(value).__name__, list(parts)
            known = f"the fields of `{kind}` are {names}" if names else f"`{kind}` has no fields"
            raise ValueError(f"`{path}` is no path of `{type(module).__name__}`: {known}.")
        value = parts[name]
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
        module = _with(module, _names(path), value)
    return module


class Replaceable(eqx.Module):
    """A model that makes others like it, and prints its numbers and static fields; abstract."""

    def replace(
        self: _Module, choices: Mapping[str, Any] | None = None, /, **parts: Any
    ) -> _Module:
        """The same model with other parts, numbers or static fields; see `EdgeDepth.replace`."""
        return replaced(self, {**(choices or {}), **parts})

    def __str__(self) -> str:
        return "\n".join(described(self))


def walk(module: Any) -> Iterator[Described]:
    """All that `describe` lists, and whatever else a user's module holds, such as functions.

    What has parts is not listed itself; `declared` tells numbers with a unit from other arrays.
    """
    layer = type(module).__module__.startswith("equinox.nn.")
    for part in _parts(module):
        if layer and part.static:
            continue
        inner = [] if part.static else list(walk(part.value))
        if not inner:
            yield part
        for row in inner:
            dot = "" if row.path.startswith("[") else "."
            yield row._replace(path=part.path + dot + row.path)


def _names(path: str) -> list[str]:
    """`a.b[0].c` as `a`, `b`, `[0]`, `c`."""
    return path.replace("[", ".[").split(".")


def _parts(module: Any) -> list[Described]:
    """The fields of a module, or the entries of a tuple or list."""
    if isinstance(module, tuple | list):
        names = getattr(module, "_fields", [f"[{i}]" for i in range(len(module))])
        pairs = zip(names, module, strict=True)
        return [Described(name, value, "", False, False, False) for name, value in pairs]
    if not dataclasses.is_dataclass(module) or isinstance(module, type):
        return []
    return [
        Described(
            field.name,
            getattr(module, field.name),
            field.metadata.get("unit", ""),
            bool(field.metadata.get("threshold", False)),
            bool(field.metadata.get("static", False)),
            "unit" in field.metadata,
        )
        for field in dataclasses.fields(module)
        # A function that is the default of a class is a method.
        if field.name in vars(module)
    ]


def _with(module: Any, names: list[str], value: Any) -> Any:
    name, *rest = names
    old = next(part.value for part in _parts(module) if part.path == name)
    new = _with(old, rest, value) if rest else value
    if hasattr(module, "_fields"):
        return module._replace(**{name: new})
    if isinstance(module, tuple | list):
        return type(module)(new if f"[{i}]" == name else x for i, x in enumerate(module))
    if type(module).__dataclass_params__.init:
        return dataclasses.replace(module, **{name: new})
    return _copied(module, name, new)


def _copied(module: _Module, name: str, value: Any) -> _Module:
    """A module with another field, of a class whose constructor takes other arguments."""
    kind, new = type(module), object.__new__(type(module))
    for field in dataclasses.fields(module):
        if field.name == name:
            convert = field.metadata.get("converter", lambda given: given)
            object.__setattr__(new, name, convert(value))
        elif field.name in vars(module):
            object.__setattr__(new, field.name, getattr(module, field.name))
    for base in reversed(kind.__mro__):
        if "__check_init__" in vars(base):
            vars(base)["__check_init__"](new)
    return new


def _is_number(value: Any) -> bool:
    return eqx.is_array(value) or isinstance(value, int | float)


def _shown(value: Any) -> str:
    """A number as such; what is traced, or an array, by its type."""
    if eqx.is_array(value) and value.ndim == 0:
        try:
            return f"{float(value):.6g}"
        except jax.errors.ConcretizationTypeError:
            pass
    return eqx.tree_pformat(value)
