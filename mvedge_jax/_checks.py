"""Checks of arguments before a program is compiled for them."""

import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool

from ._compiler import LeanJit
from ._cpu import release_memory
from ._params import as_number
from ._paths import replaced, walk
from ._pullback import primals
from ._split_jit import Halves, SplitJit

_LOG = logging.getLogger("mvedge_jax")
# Seconds after which a compiling call is reported.
_PATIENCE = 2.0


class CheckedJit:
    """A `lean_jit` function that checks its arguments first.

    Outside of JAX's transforms, a call that compiles for more than two seconds is reported by two
    warnings of the logger `mvedge_jax`, which Python shows by default.

    Attributes:
        check: takes the arguments and returns them, positional and named, with Python numbers among
            the leaves of the parameters made arrays, so that no value compiles anew; raises where
            they cannot be right.
        compiled: the function.
        traces: how often it, or a half of it, was traced, as it is whenever it is compiled.
    """

    def __init__(
        self,
        check: Callable[..., tuple[Any, ...]],
        function: Callable[..., Any],
        halves: Halves | None,
    ):
        def counted(function: Callable[..., Any]) -> Callable[..., Any]:
            @functools.wraps(function)
            def traced(*arguments: Any, **options: Any) -> Any:
                self.traces += 1
                return function(*arguments, **options)

            return traced

        self.check, self.traces = check, 0
        self.compiled: Any = (
            LeanJit(counted(function), function)
            if halves is None
            else SplitJit(counted(function), function, halves, counted)
        )
        functools.update_wrapper(self, function)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        arguments, options = self.check(*arguments, **options)
        if primals((arguments, options)) is None:
            return self.compiled(*arguments, **options)
        with self._announced():
            return self.compiled(*arguments, **options)

    def ahead(self, *arguments: Any, **options: Any) -> "_Ahead":
        """See `LeanJit`; the program checks its arguments, too."""
        arguments, options = self.check(*arguments, **options)
        return _Ahead(self.check, self.compiled.ahead(*arguments, **options))

    @contextlib.contextmanager
    def _announced(self) -> Iterator[None]:
        """Reports that the body compiles, if it takes long, and its duration."""
        start, before, said = time.perf_counter(), self.traces, threading.Event()

        def announce() -> None:
            if self.traces > before:
                said.set()
                _LOG.warning("%s is being compiled for arguments of this shape, once.", name)

        name = self.compiled.__name__
        timer = threading.Timer(_PATIENCE, announce)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
        if said.is_set():
            _LOG.warning("%s was compiled in %.0f s.", name, time.perf_counter() - start)
        if self.traces > before:
            # After `jax.clear_caches`, the program was compiled by this call.
            release_memory()

    def lower(self, *arguments: Any, **options: Any) -> "_Ahead":
        """See `lean_jit`; the compiled program checks its arguments, too."""
        arguments, options = self.check(*arguments, **options)
        return _Ahead(self.check, self.compiled.lower(*arguments, **options))


class _Ahead:
    """A lowered or compiled program that checks its arguments first."""

    def __init__(self, check: Callable[..., tuple[Any, ...]], stage: Any):
        self._check, self._stage = check, stage

    def compile(self, **options: Any) -> "_Ahead":
        return _Ahead(self._check, self._stage.compile(**options))

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        arguments, options = self._check(*arguments, **options)
        return self._stage(*arguments, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)


def checked_jit(
    check: Callable[..., tuple[Any, ...]], halves: Halves | None = None
) -> Callable[[Callable[..., Any]], Any]:
    """`lean_jit` for functions that check their arguments, in two programs if halves are given."""
    return functools.partial(CheckedJit, check, halves=halves)


def expect(name: str, value: Any, kind: type, advice: str) -> None:
    """Refuses an argument of the wrong type, such as a swapped one.

    Raises:
        TypeError: naming the argument, the type that it should have, what was given, and `advice`,
            the end of a sentence on how to get a value of that type.
    """
    if not isinstance(value, kind):
        raise TypeError(f"`{name}` must be {kind.__name__}, got {_described(value)}; {advice}.")


def check_finite(views: Any) -> None:
    """Refuses NaN in the views `[v, u, y, x, c]` of a light field; traced views pass.

    Raises:
        ValueError: naming the first view and pixel.
    """
    if isinstance(views, Tracer):
        return
    # Minimum and maximum do not tell: XLA drops NaN from them in large arrays on some CPUs. Views
    # that a traced function closes over have values, too.
    with jax.ensure_compile_time_eval():
        finite = jnp.isfinite(views)
        if bool(finite.all()):
            return
    places = np.argwhere(~np.asarray(finite))
    v, u, y, x, _ = (int(i) for i in places[0])
    raise ValueError(
        f"`views` must be finite, got NaN or infinity in {len(places)} values, the first of them "
        f"in view (v, u) = ({v}, {u}) at (x, y) = ({x}, {y})."
    )


def untraced(name: str, value: Any) -> None:
    """Raises a TypeError for traced values where the host chooses ranges and capacities."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value)):
        raise TypeError(
            f"`{name}` is traced, as everything within `jit`, `vmap` or `grad` is, but the host "
            "reads its numbers to choose ranges and capacities: make the model outside, such as by "
            "`EdgeDepth.for_light_field`, and pass it in."
        )


def _described(value: Any) -> str:
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)[:60]
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array of shape {tuple(value.shape)}"
    return type(value).__name__


def with_numbers(model: Any) -> Any:
    """A model whose declared Python numbers are arrays; outside `jit` they are checked, too.

    Raises:
        ValueError: a number is NaN, infinite or negative; names it.
    """
    for name, leaf, signed in _numbers(model):
        if not eqx.is_inexact_array(leaf) or getattr(leaf, "weak_type", False):
            model = replaced(model, {name: as_number(leaf)})
        if isinstance(leaf, Tracer):
            continue
        values = np.asarray(leaf)
        bad = ~np.isfinite(values) | (False if signed else values < 0)
        if bad.any():
            wish = "finite" if signed else "finite and not negative"
            raise ValueError(f"`{name}` must be {wish}, got {values[bad].flat[0]:g}.")
    return model


def sound(model: Any) -> Bool[Array, ""]:
    """Whether `with_numbers` accepts every number of a model, within `jit`."""
    fine = jnp.asarray(True)
    for _, leaf, signed in _numbers(model):
        ok = jnp.isfinite(leaf) if signed else jnp.isfinite(leaf) & (leaf >= 0)
        fine = fine & jnp.all(ok)
    return fine


def _numbers(model: Any) -> Iterator[tuple[str, Any, bool]]:
    """Path and value of every declared or floating leaf, and whether it may be negative."""
    for row in walk(model):
        if row.static:
            continue
        if row.declared or eqx.is_inexact_array(row.value):
            yield row.path, row.value, not row.declared
