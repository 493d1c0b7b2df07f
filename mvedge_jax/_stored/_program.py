"""A program that was compiled ahead, or read from a file."""

import functools
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.monitoring
from jax.experimental import serialize_executable
from jax.extend.core import ClosedJaxpr, Jaxpr

from ._files import ProgramFiles
from ._key import NoKey, context, described, is_abstract, program_key

# Seconds of tracing and compiling that are worth a file, as for JAX's own cache.
_WORTH = 0.3
# Stands for an array among arguments.
_ARRAY = object()


class Program:
    """A compiled program for arguments of one kind.

    Args:
        executable: maps the list of arrays among the arguments to that of the results.
        results: what the function returns, with a `jax.ShapeDtypeStruct` for every array.
    """

    def __init__(self, executable: Callable[[list[Any]], list[Any]], results: Any):
        self._executable, self.results = executable, results
        self._leaves, self._structure = jax.tree.flatten(results)

    def __call__(self, arguments: Any) -> Any:
        """Runs it on arguments of the kind that it is for."""
        arrays = iter(self._executable(_arrays(arguments)))
        return self._structure.unflatten(
            next(arrays) if is_abstract(leaf) else leaf for leaf in self._leaves
        )

    def compile(self) -> "Program":
        """Itself."""
        return self


class Lowered:
    """A program that was traced and can be compiled, in another thread as well.

    Attributes:
        results: see `Program`.
    """

    def __init__(
        self,
        traced: "_Traced",
        start: float,
        keep: Callable[[jax.stages.Compiled, Any], None] | None,
    ):
        self._traced, self.results, self._start, self._keep = traced, traced.results, start, keep
        self._context = context()

    def compile(self) -> Program | None:
        """The program, also written to its file if it has one.

        Returns:
            None in a thread where other settings of JAX hold than where it was traced.
        """
        if context() != self._context:
            return None
        _listen()
        before = _counts.requests, _counts.hits
        executable = self._traced.lowered.compile()
        if self._keep is None:
            # JAX keeps what it has compiled for the function until `jax.clear_caches`.
            return Program(self._traced.function, self.results)
        if time.perf_counter() - self._start >= _WORTH and _copyable(*before):
            self._keep(executable, self.results)
        return Program(executable, self.results)


class _Traced(NamedTuple):
    """A function of arrays, lowered for some, and what it stands for returns."""

    function: Callable[[list[Any]], list[Any]]
    lowered: jax.stages.Lowered
    results: Any


def obtain(
    function: Callable[..., Any],
    original: Callable[..., Any],
    arguments: Any,
    asked: dict[str, Any],
    files: ProgramFiles,
) -> Program | None:
    """Reads a program from its file, or compiles it and writes the file.

    Args:
        function: to compile; what is no array among its arguments and results is static.
        original: does the same, and is a function of a module.
        arguments: positional ones and those by name.
        asked: compiler options.
        files: where programs are kept.

    Returns:
        The program; None if it can't be kept in a file, as it calls back to Python, or depends on
        something that has no name beyond this process.
    """
    if _key(original, arguments, asked) is None:
        return None
    found = prepared(function, original, arguments, asked, files)
    return None if found is None else found.compile()


def prepared(
    function: Callable[..., Any],
    original: Callable[..., Any],
    arguments: Any,
    asked: dict[str, Any],
    files: ProgramFiles | None,
    *,
    about: Any = None,
    read: bool = True,
    trace: bool = True,
) -> Program | Lowered | None:
    """Reads a program from its file, or traces it.

    Args:
        function: see `obtain`.
        original: see `obtain`.
        arguments: positional ones and those by name; a `jax.ShapeDtypeStruct` stands for an array
            that another program will return.
        asked: compiler options.
        files: where programs are kept; None for nowhere. What can't be kept is not.
        about: what else the program depends on, as `arguments`.
        read: whether a file will do.
        trace: whether to trace it if there is no file.

    Returns:
        The program or what is to be compiled; None if it calls back to Python, or is not traced.
    """
    start, keep = time.perf_counter(), None
    asking = functools.partial(_key, original, (arguments, about), asked)
    key = None if files is None else asking()
    if files is not None and key is not None:
        data = files.read(key) if read else None
        if data is not None:
            try:
                return _loaded(data, len(_arrays(arguments)))
            except Exception:  # whatever a file from an account's own past may hold
                files.drop(key)
        keep = functools.partial(_write, files, key, asking)
    traced = _traced(function, arguments, asked) if trace else None
    return None if traced is None else Lowered(traced, start, keep)


def _write(
    files: ProgramFiles,
    key: str,
    asking: Callable[[], str | None],
    executable: jax.stages.Compiled,
    results: Any,
) -> None:
    data = _dumped(executable, results)
    # Nothing that the program depends on may have changed while it was traced.
    if data is not None and key == asking():
        files.write(key, data)


class _Counts(threading.local):
    """How often JAX asked its own cache, and found a program there, in each thread."""

    requests = 0
    hits = 0


_counts = _Counts()


@functools.cache
def _listen() -> None:
    """Counts from now on. For good: JAX may call listeners while another thread removes one."""

    def count(event: str, **_: Any) -> None:
        _counts.requests += event == "/jax/compilation_cache/compile_requests_use_cache"
        _counts.hits += event == "/jax/compilation_cache/cache_hits"

    jax.monitoring.register_event_listener(count)


def _copyable(requests: int, hits: int) -> bool:
    """Whether the compiler ran since the counts were these.

    What JAX reads from its own cache can't be written again: the copy lacks functions, which shows
    when it is called.
    """
    if jax.config.values.get("jax_compilation_cache_dir") is None:
        return True
    return _counts.requests > requests and _counts.hits == hits


def _key(function: Callable[..., Any], arguments: Any, asked: dict[str, Any]) -> str | None:
    try:
        return program_key(function, arguments, asked)
    except NoKey:
        return None


def _traced(function: Callable[..., Any], arguments: Any, asked: dict[str, Any]) -> _Traced | None:
    """A lowered function; None if it calls back to Python."""
    leaves, structure = jax.tree.flatten(arguments)
    # The arrays themselves are not to live as long as the function.
    fixed = [_ARRAY if is_array(leaf) else leaf for leaf in leaves]
    results: Any = None

    def flat(arrays: list[Any]) -> list[Any]:
        nonlocal results
        given = iter(arrays)
        filled = (next(given) if leaf is _ARRAY else leaf for leaf in fixed)
        positional, named = structure.unflatten(filled)
        found = function(*positional, **named)
        results = jax.tree.map(_abstract, found)
        return _arrays(found)

    flat.__name__ = function.__name__
    jitted = jax.jit(flat, compiler_options=asked)
    traced = jitted.trace(_arrays(arguments))
    if traced.jaxpr.effects or any("callback" in name for name in _primitives(traced.jaxpr.jaxpr)):
        return None
    return _Traced(jitted, traced.lower(), results)


def _arrays(tree: Any) -> list[Any]:
    return [leaf for leaf in jax.tree.leaves(tree) if is_array(leaf)]


def is_array(leaf: Any) -> bool:
    """Whether it is an array, or stands for one."""
    return eqx.is_array(leaf) or is_abstract(leaf)


def _abstract(leaf: Any) -> Any:
    if not eqx.is_array(leaf):
        return leaf
    kind = jax.typeof(leaf)
    return jax.ShapeDtypeStruct(kind.shape, kind.dtype, weak_type=kind.weak_type)


def _primitives(program: Jaxpr) -> Iterator[str]:
    """Names of all primitives, those of inner programs included."""
    for equation in program.eqns:
        yield equation.primitive.name
        for value in jax.tree.leaves(list(equation.params.values())):
            if isinstance(value, ClosedJaxpr):
                yield from _primitives(value.jaxpr)
            elif isinstance(value, Jaxpr):
                yield from _primitives(value)


def _dumped(executable: jax.stages.Compiled, results: Any) -> bytes | None:
    """Bytes of a program, if it has any."""
    try:
        described(results)
        data, *_ = serialize_executable.serialize(executable)
        return pickle.dumps((data, results))
    except (NoKey, ValueError, NotImplementedError, TypeError, AttributeError, pickle.PickleError):
        return None  # constants beside the program, or a device without serialization
    except jax.errors.JaxRuntimeError:
        return None


def _loaded(data: bytes, count: int) -> Program:
    executable, results = pickle.loads(data)
    given = jax.tree.structure((([0] * count,), {}))
    arrays = len(_arrays(results))
    returned = jax.tree.structure([0] * arrays)
    load = serialize_executable.deserialize_and_load
    return Program(load(executable, given, returned, None, jax.devices()[:1]), results)
