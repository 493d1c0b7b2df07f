"""A function of two halves as programs that are compiled side by side, with their pullbacks."""

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.core import Tracer, eval_context

from ._compiler import LeanJit, outermost
from ._cpu import compiler_options, no_collections, release_memory
from ._pullback import Pullback, attach, floating, is_floating, primals, pullback
from ._stored import Program, in_use, is_ordinary, kind_of, prepared

_P = ParamSpec("_P")
_T = TypeVar("_T")


class Halves(NamedTuple):
    """A function of a module as two others, `second(first(*a), *b)`.

    Attributes:
        split: takes the function's arguments and returns `a` and `b`.
        first: of a module, too.
        second: likewise.
    """

    split: Callable[..., tuple[tuple[Any, ...], tuple[Any, ...]]]
    first: Callable[..., Any]
    second: Callable[..., Any]


class SplitJit(LeanJit[_P, _T]):
    """As `LeanJit`, but two programs outside of JAX's transforms, compiled side by side.

    Either is compiled again only for other arguments of its own. Under `jax.grad`, `vjp` and
    `linearize` outside of other transforms, either is two: its value with residuals, and its
    pullback. Where JAX or the arguments ask for more than that on one CPU, and where a half calls
    back to Python, it is one program.

    Args:
        function: see `LeanJit`.
        original: see `LeanJit`.
        halves: of `original`.
        counted: wraps a half, to count its traces.
    """

    def __init__(
        self,
        function: Callable[_P, _T],
        original: Callable[..., Any],
        halves: Halves,
        counted: Callable[[Callable[..., Any]], Callable[..., Any]],
    ):
        super().__init__(function, original)
        self._split, *parts = halves
        self._parts = [(counted(part), part) for part in parts]

    def __call__(self, *arguments: _P.args, **options: _P.kwargs) -> _T:
        given = arguments, options
        values = primals(given)
        if values is None or not outermost(values):
            return super().__call__(*arguments, **options)
        # Outside of `jax.grad`, where the programs would be others to JAX.
        with eval_context():
            run = self._both(given, values)
            found = None if run is None else run(values)
        if found is None:
            return super().__call__(*arguments, **options)
        results, pull = found
        return results if pull is None else self._attached(given, results, pull)

    def ahead(self, *arguments: _P.args, **options: _P.kwargs) -> Callable[_P, _T]:
        """See `LeanJit`."""
        given = arguments, options
        run = self._both(given, given) if outermost(given) else None
        if run is None:
            return super().ahead(*arguments, **options)
        return self._for_one_kind(lambda given: run(given)[0], kind_of(given))

    def _both(self, given: Any, values: Any) -> Callable[[Any], Any] | None:
        """The programs of both halves, compiled if they are new.

        Args:
            given: positional and named arguments; results are differentiated by its tracers.
            values: the same without tracers.

        Returns:
            Maps such values to the results and, if there are tracers, their pullback: a function
            that maps cotangents of the floating results to those of the tracers, by `id`. None if
            it has to be one program.
        """
        if not is_ordinary(values):
            return None
        self._forget()
        known = len(self._programs)
        leaves = [jax.tree.leaves(half) for half in self._split(*given[0], **given[1])]
        moves = [[isinstance(leaf, Tracer) for leaf in half] for half in leaves]

        arguments, others = self._split(*values[0], **values[1])
        key, first = self._half(0, arguments, moves[0])
        if first is None:
            return None
        beside = None
        if not isinstance(first, Program):
            # The compiler runs outside of Python's lock, while the second half is traced here.
            thread = ThreadPoolExecutor(1)
            beside = thread.submit(self._kept, key, first)
            thread.shutdown(wait=False)
        passed = [any(moves[0]) and is_floating(leaf) for leaf in jax.tree.leaves(first.results)]
        second = self._kept(*self._half(1, (first.results, *others), [*passed, *moves[1]]))
        # Nothing comes from a thread in which other settings of JAX hold.
        first = (beside and beside.result()) or self._kept(key, first)
        if len(self._programs) > known:
            release_memory()
        if first is None or second is None:
            return None
        chosen = [[id(leaf) for leaf in half if isinstance(leaf, Tracer)] for half in leaves]
        return functools.partial(self._run, first, second, chosen)

    def _run(
        self, first: Any, second: Any, chosen: Sequence[Sequence[int]], values: Any
    ) -> tuple[_T, Any]:
        """Results of both halves, and the pullback; `chosen` are the tracers that either reads."""
        arguments, others = self._split(*values[0], **values[1])
        between, back = _applied(first, arguments)
        results, last = _applied(second, (between, *others))
        if last is None:
            return results, None
        layout = jax.tree.structure(floating(between))

        def pull(cotangents: Any) -> dict[int, Array]:
            found = last(cotangents)
            passed = len(found) - len(chosen[1])
            slopes = list(zip(chosen[1], found[passed:], strict=True))
            if back is not None:
                release_memory()
                slopes += zip(chosen[0], back(layout.unflatten(found[:passed])), strict=True)
            total: dict[int, Array] = {}
            for leaf, slope in slopes:
                total[leaf] = total[leaf] + slope if leaf in total else slope
            return total

        return results, pull

    def _half(self, index: int, arguments: tuple[Any, ...], moves: list[bool]) -> tuple[Any, Any]:
        """The key of a half for such arguments, and its programs or what is to be compiled."""
        function, original = self._parts[index]
        moving = tuple(moves) if any(moves) else ()
        key = index, kind_of((arguments, {})), moving
        if key in self._programs:
            return key, self._programs[key]
        with no_collections():
            asked, files = compiler_options(), in_use()
            if moving:
                return key, pullback(function, original, arguments, moving, asked, files)
            return key, prepared(function, original, (arguments, {}), asked, files)

    def _kept(self, key: Any, found: Any) -> Any:
        """Compiles a half and keeps it, whatever becomes of the other one."""
        compiled = None if found is None else found.compile()
        if compiled is not None or found is None:
            self._programs[key] = compiled
        return compiled

    def _attached(self, given: Any, results: Any, pull: Callable[[Any], dict[int, Array]]) -> _T:
        """The results as JAX differentiates them."""
        leaves, structure = jax.tree.flatten(given)
        by_id = {id(leaf): leaf for leaf in leaves if isinstance(leaf, Tracer)}
        tracers = list(by_id.values())
        values = primals(tracers)
        found, layout = jax.tree.flatten(floating(results))

        def whole(*values: Array) -> list[Array]:
            """The same as one program."""
            changed = dict(zip(by_id, values, strict=True))
            arguments, options = structure.unflatten(changed.get(id(x), x) for x in leaves)
            return jax.tree.leaves(floating(self._nested(*arguments, **options)))

        def push(*tangents: Array) -> list[Array]:
            return jax.jvp(whole, tuple(values), tangents)[1]

        def pulled(cotangents: list[Array]) -> list[Array]:
            if not outermost(cotangents):
                return list(jax.vjp(whole, *values)[1](cotangents))
            with eval_context():
                found = pull(layout.unflatten(cotangents))
                none = map(jnp.zeros_like, values)  # of what neither half reads
                return [found.get(leaf, zero) for leaf, zero in zip(by_id, none, strict=True)]

        return eqx.combine(layout.unflatten(attach(found, tracers, push, pulled)), results)


def _applied(half: Program | Pullback, arguments: tuple[Any, ...]) -> tuple[Any, Any]:
    """Results of a half, and its pullback if it has one."""
    if isinstance(half, Pullback):
        return half(arguments)
    return half((arguments, {})), None
