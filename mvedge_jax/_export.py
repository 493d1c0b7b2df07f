"""Registration of this package's types, so that `jax.export` can serialize them."""

import dataclasses
import inspect
import json
import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import equinox as eqx
import jax
from jax import export

_PLAIN = str | int | float | bool | None
_registered: set[type] = set()
# Dataclasses that are static choices, such as `SplatRaster`, by name.
_choices: dict[str, type] = {}


def register(package: str) -> None:
    """Registers the public data types of a package that is imported, of modules below it, too."""
    for kind in _types(package):
        if kind in _registered:
            continue
        _registered.add(kind)
        name = _public_name(kind)
        if issubclass(kind, eqx.Module):
            _register_module(kind, name)
        elif dataclasses.is_dataclass(kind):
            _choices[name] = kind
        else:
            export.register_namedtuple_serialization(kind, serialized_name=name)


def _public_name(kind: type) -> str:
    rooms = (part for part in kind.__module__.split(".") if not part.startswith("_"))
    return ".".join([*rooms, kind.__qualname__])


def _types(package: str) -> Iterator[type]:
    """Named tuples, modules and dataclasses where they are defined, unless private or abstract."""
    for name, module in sorted(sys.modules.items()):
        if name != package and not name.startswith(f"{package}."):
            continue
        for kind in list(vars(module).values()):
            if not isinstance(kind, type) or kind.__module__ != name or kind.__name__[:1] == "_":
                continue
            named = issubclass(kind, tuple) and hasattr(kind, "_fields")
            if named or (dataclasses.is_dataclass(kind) and not inspect.isabstract(kind)):
                yield kind


def _register_module(kind: type[eqx.Module], name: str) -> None:
    fields = dataclasses.fields(kind)  # pyright: ignore
    static = [field.name for field in fields if field.metadata.get("static", False)]
    # Equinox keeps static fields in a tuple of its own making: where each is, a sample tells.
    marks = {field: object() for field in static}
    sample = list(_auxiliary(kind, marks))
    places = {field: sample.index(mark) for field, mark in marks.items()}

    def written(auxiliary: tuple[Any, ...]) -> bytes:
        values = {field: _plain(f"{name}.{field}", auxiliary[at]) for field, at in places.items()}
        return json.dumps(values).encode()

    def read(data: bytes) -> tuple[Any, ...]:
        values = json.loads(data)
        return _auxiliary(kind, {field: _restored(values[field]) for field in static})

    export.register_pytree_node_serialization(
        kind, serialized_name=name, serialize_auxdata=written, deserialize_auxdata=read
    )


def _auxiliary(kind: type[eqx.Module], static: dict[str, Any]) -> tuple[Any, ...]:
    """What JAX is told of a module beside its leaves."""
    module = object.__new__(kind)
    for field in dataclasses.fields(kind):  # pyright: ignore
        object.__setattr__(module, field.name, static.get(field.name))
    flat: Any = jax.tree_util.default_registry.flatten_one_level(module)
    return flat[1]


def _plain(name: str, value: Any) -> Any:
    """A static value in JSON: tuples as lists, dataclasses as their name and fields."""
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, tuple):
        return list(map(partial(_plain, name), value))
    kind = _public_name(type(value))
    if type(value) is _choices.get(kind):
        names = [field.name for field in dataclasses.fields(value)]
        return {kind: {field: _plain(f"{name}.{field}", getattr(value, field)) for field in names}}
    raise TypeError(
        f"A program whose arguments hold `{name}` = {value!r} cannot be serialized: static fields "
        "may be text, numbers, truth values, None, tuples and this package's dataclasses of them. "
        "Close over this argument, or pass its arrays alone."
    )


def _restored(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_restored, value))
    if isinstance(value, dict):
        ((kind, fields),) = value.items()
        return _choices[kind](**{name: _restored(field) for name, field in fields.items()})
    return value
