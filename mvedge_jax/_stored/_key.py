"""What a compiled program depends on, as a key that is the same in every process."""

import dataclasses
import enum
import functools
import hashlib
import importlib
import inspect
import os
import platform
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import SingleDeviceSharding

# Versions of these packages are part of the key, so what they define can be named. What anybody
# else defines may change from one process to the next under the same name.
_VERSIONED = ("jax", "jaxlib", "equinox", "lineax", "numpy")
_PACKAGE = __name__.partition(".")[0]
_TRUSTED = {_PACKAGE, "builtins", *_VERSIONED}
_PLAIN = (type(None), bool, int, float, complex, str, bytes)
# Where the files are and what is logged changes no program.
_NO_MATTER = re.compile(r"jax_(compilation_cache_dir|persistent_cache.*|log_.*|logging_level)")
# With one of these on, JAX looks at what programs do, or doesn't compile them: its own path then.
_DIAGNOSTIC = (
    "jax_debug_nans",
    "jax_debug_infs",
    "jax_debug_key_reuse",
    "jax_disable_jit",
    "jax_enable_checks",
    "jax_check_tracer_leaks",
    "jax_explain_cache_misses",
    "jax_no_tracing",
    "jax_no_execution",
)
_MATTERS_TO_COMPILER = ("XLA_", "TF_", "PJRT_", "NPROC", "EQX_", "CUDA_", "NVIDIA_", "LIBTPU_")
# Clocks of file systems tick a few times in a hundredth of a second.
_IMPORTED = time.time() - 0.01


class NoKey(Exception):
    """A program depends on something that has no name beyond this process."""


def program_key(function: Callable[..., Any], arguments: Any, asked: dict[str, Any]) -> str:
    """The key of a program for arguments like these.

    Args:
        function: what is compiled.
        arguments: a pytree; of arrays, only their kind matters.
        asked: compiler options.

    Returns:
        Letters and digits.

    Raises:
        NoKey: a function or a class is not from the package and the libraries whose versions are
            known, an array lies elsewhere than on the default device, that is no CPU, JAX is
            diagnosing, or the package was changed since it was imported: its sources or, in this
            process, what its modules and classes hold.
    """
    _check_ordinary()
    replaced = replaced_name()
    if replaced is not None:
        raise NoKey(f"{replaced} was replaced")
    parts = (
        _name_of_function(function),
        described(arguments),
        repr(sorted(asked.items())),
        context(),
        _surroundings(),
        _sources(),
    )
    text = "\n".join(parts)
    if re.search(r" at 0x[0-9a-f]+>", text):
        raise NoKey("an address of this process")
    return hashlib.blake2b(text.encode("utf-8", "backslashreplace"), digest_size=32).hexdigest()


def is_ordinary(arguments: Any) -> bool:
    """Whether arguments are wherever JAX puts them, on one CPU, and JAX is not diagnosing."""
    arrays = [leaf for leaf in jax.tree.leaves(arguments) if eqx.is_array(leaf)]
    if any(getattr(array, "committed", False) for array in arrays):
        return False
    try:
        _check_ordinary()
        for array in arrays:
            _kind_of_array(array)
    except NoKey:
        return False
    return True


def _check_ordinary() -> None:
    if any(map(_setting, _DIAGNOSTIC)):
        raise NoKey("JAX is diagnosing")
    if jax.default_backend() != "cpu":
        raise NoKey("a device on which no copy of a program was tried")
    if jax.process_count() > 1 or not jax.sharding.get_abstract_mesh().empty:
        raise NoKey("several processes, or a mesh")


# What names of the package stood for when they were first looked at, in this process.
_seen: dict[tuple[str, ...], Any] = {}


def replaced_name() -> str | None:
    """A constant, function, class or method of the package that isn't what it was at the last call.

    The sources do not tell what a script has put into a module.
    """
    for place, value in _names():
        if _seen.setdefault(place, value) is not value:
            return ".".join(place)
    return None


def _names() -> Iterator[tuple[tuple[str, ...], Any]]:
    own = __name__.rpartition(".")[0]
    for module, content in list(sys.modules.items()):
        if _root(module) != _PACKAGE or module.startswith(own):
            continue
        for name, value in list(vars(content).items()):
            if name.startswith("__"):
                continue
            yield (module, name), value
            if isinstance(value, type) and value.__module__ == module:
                items = list(vars(value).items())
                yield from (
                    ((module, name, x), y) for x, y in items if x == "__call__" or x[:2] != "__"
                )


def context() -> str:
    """JAX's settings, as its context managers have them at this moment."""
    return repr([_setting(name) for name in _settings()])


def _setting(name: str) -> Any:
    try:
        return getattr(jax.config, name)
    except AttributeError:  # of these, `values` makes a new dictionary at every look
        return jax.config.values.get(name)


def kind_of(arguments: Any) -> Any:
    """What decides, within this process, whether arguments share a program; hashable.

    A `jax.ShapeDtypeStruct` counts as what a program returns.
    """
    leaves, structure = jax.tree.flatten(arguments)
    return structure, context(), *map(_kind_of_leaf, leaves)


def is_abstract(leaf: Any) -> bool:
    """Whether it stands for an array that a program will return, on the default device."""
    return isinstance(leaf, jax.ShapeDtypeStruct)


def _kind_of_leaf(leaf: Any) -> Any:
    if is_abstract(leaf):
        place: Any = SingleDeviceSharding(jax.devices()[0]), False
    elif eqx.is_array(leaf):
        place = getattr(leaf, "sharding", None), getattr(leaf, "committed", None)
    else:
        return type(leaf), leaf
    return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False), place


@functools.cache
def _settings() -> tuple[str, ...]:
    return tuple(name for name in sorted(jax.config.values) if not _NO_MATTER.fullmatch(name))


def _name_of_function(function: Callable[..., Any]) -> str:
    """The function's name, if that is all there is to it; what wraps another has the other's."""
    name = f"{function.__module__}.{function.__qualname__}"
    at_home = _root(getattr(function, "__globals__", {}).get("__name__", "")) in _TRUSTED
    if not at_home or inspect.unwrap(function) is not function:
        raise NoKey(f"{name} is not the package's")
    if inspect.unwrap(_found(function.__module__, function.__qualname__)) is not function:
        raise NoKey(f"{name} is another function")
    return name


def _name(value: Any) -> str:
    """The name of a class or function, which it must have where it was defined."""
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if not (isinstance(module, str) and isinstance(name, str) and _root(module) in _TRUSTED):
        raise NoKey(f"{value!r} is neither the package's nor of a library with a known version")
    if _found(module, name) is not value:
        raise NoKey(f"{module}.{name} is something else")
    return f"{module}.{name}"


def _root(module: str) -> str:
    return module.partition(".")[0]


def _found(module: str, name: str) -> Any:
    try:
        return functools.reduce(getattr, name.split("."), sys.modules[module])
    except (KeyError, AttributeError) as missing:
        raise NoKey(f"{module}.{name} is nowhere") from missing


def described(value: Any, *, static: bool = False) -> str:
    """Everything that a program can read of a value while it is traced.

    Args:
        value: any pytree, of classes with a name.
        static: whether an array in it would be a constant of the program.

    Returns:
        One line, the same in every process.

    Raises:
        NoKey: there is none.
    """
    if type(value) in _PLAIN:
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, np.generic) and static:
        return f"{value.dtype} {value!r}"
    if isinstance(value, jax.Array | np.ndarray | np.generic | jax.ShapeDtypeStruct):
        if static:
            raise NoKey("an array among static fields")
        return _kind_of_array(value)
    if isinstance(value, np.dtype):
        return f"dtype {value.str}"
    if isinstance(value, type) or (callable(value) and hasattr(value, "__qualname__")):
        return _name(value)
    # What is no pytree goes into the program with all that it holds.
    static = static or jax.tree_util.all_leaves((value,))
    return f"{_name(type(value))}({', '.join(_contents(value, static))})"


def _contents(value: Any, static: bool) -> Iterator[str]:
    if isinstance(value, enum.Enum):
        yield value.name
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            fixed = static or field.metadata.get("static", False)
            yield f"{field.name}={described(getattr(value, field.name), static=fixed)}"
    elif isinstance(value, tuple | list):
        yield from (described(item, static=static) for item in value)
    elif isinstance(value, dict):
        for key in sorted(value, key=repr):
            yield f"{described(key, static=True)}: {described(value[key], static=static)}"
    else:
        raise NoKey(f"{value!r} may be anything")


def _kind_of_array(array: Any) -> str:
    kind = f"{array.dtype}{list(array.shape)}"
    default = jax.devices()[:1]
    if is_abstract(array):
        memory = SingleDeviceSharding(default[0]).memory_kind
        return f"array {kind} weak={array.weak_type} put=False memory={memory}"
    if not isinstance(array, jax.Array):
        return f"numpy {kind}"
    sharding = array.sharding
    here = isinstance(sharding, SingleDeviceSharding) and list(sharding.device_set) == default
    if not here or _setting("jax_default_device") is not None:
        raise NoKey("not on the default device")
    weak, put = getattr(array, "weak_type", False), getattr(array, "committed", False)
    return f"array {kind} weak={weak} put={put} memory={sharding.memory_kind}"


@functools.cache
def _surroundings() -> str:
    """Versions, the machine, and what the environment tells the compiler."""
    versions = [(name, importlib.import_module(name).__version__) for name in _VERSIONED]
    device = jax.devices()[0]
    environment = sorted(x for x in os.environ.items() if x[0].startswith(_MATTERS_TO_COMPILER))
    # The compiler splits loops by the cores that the process may use.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    found = (
        sys.version,
        versions,
        device.client.platform_version,
        (device.platform, device.device_kind, len(jax.devices())),
        (platform.system(), platform.machine(), _processor(), cores),
        environment,
    )
    return repr(found)


def _processor() -> str:
    """What the processor can do; where the system doesn't say, which machine it is."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return f"{platform.processor()} of {platform.node()}"
    told = ("vendor_id", "cpu family", "model", "flags", "Features", "CPU ")
    return repr(sorted({line for line in lines if line.startswith(told)}))


def _sources() -> str:
    """A hash of the package's sources, if they are those that were imported.

    Of their contents (15 ms, once per process): sizes and times of two versions may agree where a
    package manager or `rsync` sets the times.
    """
    root = Path(__file__).parents[1]
    files = tuple((path, path.stat().st_mtime) for path in sorted(root.rglob("*.py")))
    if not files or max(changed for _, changed in files) > _IMPORTED:
        raise NoKey("the package's sources have changed since it was imported")
    return _hash_of(root, tuple(path for path, _ in files))


@functools.cache
def _hash_of(root: Path, paths: tuple[Path, ...]) -> str:
    found = hashlib.blake2b()
    for path in paths:
        data = path.read_bytes()
        found.update(f"{path.relative_to(root).as_posix()} {len(data)}\n".encode())
        found.update(data)
    return found.hexdigest()
