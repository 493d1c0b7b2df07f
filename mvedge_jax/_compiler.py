"""Programs of this package: compiler options of the outermost `jit`, and released memory."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, Generic, ParamSpec, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer

from ._cpu import compiler_options, no_collections, release_memory
from ._stored import Program, ProgramFiles, in_use, kind_of, obtain

_P = ParamSpec("_P")
_T = TypeVar("_T")
# Number of detected calls of `jax.clear_caches`; process-wide, like JAX's caches.
_clearings = [0]


@functools.cache
def _probe(backend: str) -> Callable[[float], Any]:
    return jax.jit(lambda x: x, compiler_options=compiler_options())


def outermost(arguments: Any) -> bool:
    """Whether JAX would take compiler options of a `jit` of these arguments."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(arguments)):
        return False
    try:
        # A call within a `jit` is part of it, even if its arguments are constants.
        probe: Any = _probe(jax.default_backend())
        empty = probe._cache_size() == 0
        probe(0.0)
        _clearings[0] += empty
    except ValueError:
        return False
    return True


def _devices(value: Any) -> set[frozenset[Any]]:
    """Devices to which the arrays of a value are committed."""
    leaves = (leaf for leaf in jax.tree.leaves(value) if not isinstance(leaf, Tracer))
    return {frozenset(x.sharding.device_set) for x in leaves if getattr(x, "committed", False)}


def _check_devices(function: Callable[..., Any], arguments: Any, options: Any) -> None:
    """Refuses arguments on different devices.

    Raises:
        ValueError: naming them and their devices.
    """
    if len(_devices((arguments, options))) < 2:
        return
    named = inspect.signature(function).bind(*arguments, **options).arguments
    on = {name: sorted({str(d) for x in _devices(v) for d in x}) for name, v in named.items()}
    places = ", ".join(f"`{name}` on {' and '.join(which)}" for name, which in on.items() if which)
    raise ValueError(
        f"Arguments of `{function.__name__}` are on different devices: {places}. Put all of them "
        "on one, as by `jax.device_put(model, device)`."
    )


class LeanJit(Generic[_P, _T]):
    """The result of `lean_jit`.

    Args:
        function: what to compile.
        original: the function that `function` wraps without changing its results, if any; files of
            programs are named after it.
    """

    __wrapped__: Callable[_P, _T]

    def __init__(self, function: Callable[_P, _T], original: Callable[..., Any] | None = None):
        self._function, self._original = function, original or function
        self._nested: Any = eqx.filter_jit(function)
        self._outermost: Any = None
        self._known: set[Any] = set()
        self._programs: dict[Any, Program | None] = {}
        self._clearings = 0
        functools.update_wrapper(self, function)

    def __call__(self, *arguments: _P.args, **options: _P.kwargs) -> _T:
        if not outermost((arguments, options)):
            return self._nested(*arguments, **options)
        _check_devices(self._function, arguments, options)
        stored = self._stored((arguments, options))
        if stored is not None:
            return stored((arguments, options))
        program = self._ahead(arguments, options)
        return program(*arguments, **options)

    def ahead(self, *arguments: _P.args, **options: _P.kwargs) -> Callable[_P, _T]:
        """A separate program for arguments like these, read from its file or compiled.

        Returns:
            The program; it raises a TypeError for arguments of another kind.
        """
        _check_devices(self._function, arguments, options)
        files = in_use() if outermost((arguments, options)) else None
        stored = None if files is None else self._load((arguments, options), files)
        if stored is None:
            return self.lower(*arguments, **options).compile()
        return self._for_one_kind(stored, kind_of((arguments, options)))

    def _for_one_kind(self, program: Callable[[Any], _T], kind: Any) -> Callable[_P, _T]:
        """A program that refuses arguments of another kind."""

        def run(*arguments: _P.args, **options: _P.kwargs) -> _T:
            if kind_of((arguments, options)) != kind:
                raise TypeError(
                    f"`{self._function.__name__}` was compiled for arguments of other shapes, "
                    "dtypes or static fields."
                )
            return program((arguments, options))

        return run

    def _stored(self, arguments: Any) -> Program | None:
        """The program in the cache folder, if `compilation_cache` is on."""
        files = in_use()
        if files is None:
            return None
        self._forget()
        kind = kind_of(arguments)
        if kind not in self._programs:
            self._programs[kind] = self._load(arguments, files)
        return self._programs[kind]

    def _forget(self) -> None:
        """Forgets its programs if JAX was told to forget its own."""
        if self._clearings != _clearings[0]:
            self._programs.clear()
            self._clearings = _clearings[0]

    def _load(self, arguments: Any, files: ProgramFiles) -> Program | None:
        with no_collections():
            asked = compiler_options()
            program = obtain(self._function, self._original, arguments, asked, files)
        release_memory()
        return program

    def _ahead(self, arguments: Any, options: Any) -> Any:
        """JAX's own program, compiled."""
        program = self._program(arguments, options)
        leaves, structure = jax.tree.flatten((arguments, options))
        kind = structure, *(jax.typeof(x) if hasattr(x, "dtype") else x for x in leaves)
        if kind not in self._known:
            # JAX caches ahead-of-time programs, and memory is released before their arrays.
            with no_collections():
                program.lower(*arguments, **options).compile()
            self._known.add(kind)
            release_memory()
        return program

    def lower(self, *arguments: _P.args, **options: _P.kwargs) -> Any:
        """See `equinox.filter_jit`."""
        _check_devices(self._function, arguments, options)
        with no_collections():
            return self._program(arguments, options).lower(*arguments, **options)

    def _program(self, *arguments: Any) -> Any:
        if not outermost(arguments):
            return self._nested
        if self._outermost is None:
            # Not before the first call, because the options depend on the device.
            jit: Any = eqx.filter_jit
            self._outermost = jit(self._function, compiler_options=compiler_options())
        return self._outermost


def lean_jit(function: Callable[_P, _T]) -> LeanJit[_P, _T]:
    """`equinox.filter_jit` of a whole program, with less memory and compile time.

    It sets `compiler_options`, returns the compiler's free memory to the system before the program
    runs, and suspends garbage collection during tracing. Within another `jit`, and under `grad`
    without one, it is plain `equinox.filter_jit`.

    Args:
        function: what to compile; arrays among its arguments are traced, all else is static.

    Returns:
        The compiled function, with `lower` as `equinox.filter_jit` has it. Differentiable as it is.

    Example:
        >>> slope = lean_jit(jax.grad(lambda x: x * x))
        >>> float(slope(jax.numpy.asarray(3.0)))
        6.0
    """
    return LeanJit(function)
