"""Reverse mode outside of `jit`: a value with residuals, and its pullback, as programs."""

import uuid
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.core import ShapedArray, Tracer
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from ._stored import Lowered, Program, ProgramFiles, is_array, prepared

_Push = Callable[..., Sequence[Any]]
_Pull = Callable[[list[Array]], Sequence[Any]]


def primals(tree: Any) -> Any:
    """A tree without the tracers of `jax.grad`, `vjp` and `linearize` outside of other transforms.

    Returns:
        Their values in place of these tracers; None if there are tracers of other kinds.
    """

    def value(leaf: Any) -> Any:
        # Tracers of `jax.jvp` have a concrete tangent.
        if not (isinstance(leaf, Tracer) and isinstance(getattr(leaf, "tangent", None), Tracer)):
            return leaf
        found = getattr(leaf, "primal", leaf)
        return found if eqx.is_array(found) else jnp.asarray(found, leaf.dtype)

    found = jax.tree.map(value, tree)
    return None if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(found)) else found


class Pullback:
    """A function as two programs: its value with residuals, and the pullback of a cotangent.

    Args:
        forward: maps arguments to what `_Function.forward` returns.
        backward: see `_Function.backward`.
        moving: for each leaf of the arguments, whether the pullback has a cotangent of it.

    Attributes:
        results: see `Program`.
    """

    def __init__(self, forward: Any, backward: Any, moving: tuple[bool, ...]):
        self._forward, self._backward, self._moving = forward, backward, moving
        self.results = forward.results.results

    def __call__(self, arguments: tuple[Any, ...]) -> tuple[Any, Callable[[Any], list[Array]]]:
        """The results, and the pullback.

        The pullback maps cotangents of the floating results (`floating`) to those of the arguments
        that move. Its first call frees the residuals, which later ones compute again.
        """
        given = arguments, {"moving": self._moving}
        results, residuals = _parted(arguments, self._forward(given))

        def pull(cotangents: Any) -> list[Array]:
            if not residuals:
                residuals.extend(_parted(arguments, self._forward(given))[1])
            found = self._backward(((residuals, cotangents), {}))
            residuals.clear()
            return found

        return results, pull

    def compile(self) -> "Pullback | None":
        """See `Lowered`."""
        forward, backward = self._forward.compile(), self._backward.compile()
        if forward is None or backward is None:
            return None
        return Pullback(forward, backward, self._moving)


def pullback(
    function: Callable[..., Any],
    original: Callable[..., Any],
    arguments: tuple[Any, ...],
    moving: tuple[bool, ...],
    asked: dict[str, Any],
    files: ProgramFiles | None,
) -> Pullback | None:
    """Reads both programs from their files, or traces both.

    Args:
        function: see `prepared`.
        original: see `prepared`.
        arguments: see `prepared`.
        moving: see `Pullback`; floating arrays.
        asked: compiler options.
        files: see `prepared`.

    Returns:
        What is to be compiled, or is; None if the function calls back to Python.
    """
    of, given = _Function(function), (arguments, {"moving": moving})

    def forward(*, read: bool) -> Program | Lowered | None:
        return prepared(of.forward, original, given, asked, files, read=read)

    def backward(found: Program | Lowered, *, trace: bool) -> Program | Lowered | None:
        results, residuals = _parted(arguments, found.results)
        pulled = (residuals, floating(results)), {}
        # Residuals of one trace are for the pullback of that trace alone.
        about = given, found.results.trace
        return prepared(
            of.backward, original, pulled, asked, files, about=about, read=not trace, trace=trace
        )

    first = forward(read=True)
    second = None
    if isinstance(first, Program):
        second = backward(first, trace=False)
        if second is None:
            first = forward(read=False)
    if first is None:
        return None
    if second is None:
        second = backward(first, trace=True)
    return None if second is None else Pullback(first, second, moving)


def floating(tree: Any) -> Any:
    """A tree with its floating arrays alone, or what stands for them."""
    return eqx.filter(tree, is_floating)


def is_floating(leaf: Any) -> bool:
    """Whether it is a floating array or stands for one."""
    return is_array(leaf) and jnp.issubdtype(leaf.dtype, jnp.inexact)


class _Kept(NamedTuple):
    """What a function returns with its residuals.

    Attributes:
        results: of the function.
        fresh: residuals that are no arguments.
        places: for each residual which argument it is, if any.
        trace: name of the trace, another one every time.
    """

    results: Any
    fresh: list[Array]
    places: tuple[int | None, ...]
    trace: str


class _Function:
    """What the two programs of a function compute."""

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        self._structure: Any = None

    def forward(self, *arguments: Any, moving: tuple[bool, ...]) -> _Kept:
        """The results and the residuals."""
        leaves, structure = jax.tree.flatten(arguments)
        static: Any = None

        def of(chosen: list[Array]) -> tuple[Any, Any]:
            nonlocal static
            given = iter(chosen)
            filled = [
                next(given) if moves else leaf for leaf, moves in zip(leaves, moving, strict=True)
            ]
            results = self._function(*structure.unflatten(filled))
            kept = floating(results)
            rest = eqx.filter(results, is_floating, inverse=True)
            others, static = eqx.partition(rest, eqx.is_array)
            return kept, others

        chosen = [leaf for leaf, moves in zip(leaves, moving, strict=True) if moves]
        kept, pull, others = jax.vjp(of, chosen, has_aux=True)
        residuals, self._structure = jax.tree.flatten(pull)
        place = {id(leaf): number for number, leaf in enumerate(leaves) if eqx.is_array(leaf)}
        places = tuple(place.get(id(residual)) for residual in residuals)
        fresh = [x for x, known in zip(residuals, places, strict=True) if known is None]
        return _Kept(eqx.combine(kept, others, static), fresh, places, uuid.uuid4().hex)

    def backward(self, residuals: list[Array], cotangents: Any) -> list[Array]:
        """Cotangents of the arguments that move."""
        return self._structure.unflatten(residuals)(cotangents)[0]


def _parted(arguments: Any, kept: _Kept) -> tuple[Any, list[Any]]:
    """The results and all residuals, some of which are arguments."""
    leaves, others = jax.tree.leaves(arguments), iter(kept.fresh)
    residuals = [next(others) if place is None else leaves[place] for place in kept.places]
    return kept.results, residuals


def attach(leaves: list[Array], tracers: list[Any], push: _Push, pull: _Pull) -> list[Any]:
    """Floating arrays as a function of tracers, with derivatives that are given.

    Args:
        leaves: the values.
        tracers: what they depend on.
        push: maps a tangent of every tracer to those of the values; linear, and takes tracers.
        pull: its transpose.

    Returns:
        The values, as tracers.
    """

    @jax.custom_jvp
    def known(*_: Any) -> list[Array]:
        return leaves

    @known.defjvp
    def _(_: Any, tangents: Any) -> tuple[list[Array], list[Array]]:
        kinds = tuple(ShapedArray(leaf.shape, leaf.dtype) for leaf in leaves)
        return leaves, list(_pushed.bind(*tangents, push=push, pull=pull, kinds=kinds))

    return known(*tracers)


_pushed = Primitive("pushed_forward")
_pushed.multiple_results = True


def _call(*tangents: Any, push: _Push, **_: Any) -> Sequence[Any]:
    return push(*tangents)


def _push_linear(given: Any, tangents: Any, **how: Any) -> Any:
    moved = _pushed.bind(*map(ad.instantiate_zeros, tangents), **how)
    return _pushed.bind(*given, **how), moved


def _pull_linear(cotangents: Any, *_: Any, pull: _Pull, **__: Any) -> Sequence[Any]:
    return pull([ad.instantiate_zeros(cotangent) for cotangent in cotangents])


def _batch(tangents: Any, axes: Any, *, push: _Push, **_: Any) -> Any:
    out = jax.vmap(push, in_axes=tuple(axes))(*tangents)
    return out, [0] * len(out)


_pushed.def_impl(_call)
_pushed.def_abstract_eval(lambda *_, kinds, **__: list(kinds))
ad.primitive_jvps[_pushed] = _push_linear
ad.primitive_transposes[_pushed] = _pull_linear
batching.primitive_batchers[_pushed] = _batch
mlir.register_lowering(_pushed, mlir.lower_fun(_call, multiple_results=True))
