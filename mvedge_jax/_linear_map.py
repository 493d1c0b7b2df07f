"""Linear maps with a transpose of one's own, which forward mode still sees through.

`jax.custom_vjp` has no forward mode, and `jax.custom_jvp` leaves the transpose to JAX, which has
none for loops of unknown length. Here a map comes with its transpose, and both are functions that
JAX can differentiate forwards with respect to what they are not linear in.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

_Flat = Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]]
_linear_map = Primitive("linear_map")
_linear_map.multiple_results = True


def linear_map(
    forward: Callable[[Any, Any], Any],
    transpose: Callable[[Any, Any], Any],
    fixed: Any,
    moving: Any,
) -> Any:
    """`forward(fixed, moving)`, which is linear in `moving`, with a transpose that is given.

    Args:
        forward: maps `fixed` and `moving` to a pytree; linear in `moving`.
        transpose: maps `fixed` and a cotangent of that pytree to one of `moving`; linear in the
            cotangent.
        fixed: pytree of arrays that the map depends on in any way.
        moving: pytree of floating arrays.

    Returns:
        The value of the map. It can be transposed with respect to `moving`, any number of times,
        differentiated forwards with respect to everything, and batched. Reverse mode with respect
        to `fixed` is that of the two functions.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> def twice(factor, x):
        ...     return linear_map(lambda f, x: f * x, lambda f, ct: f * ct, factor, x)
        >>> float(jax.linear_transpose(lambda x: twice(2.0, x), 1.0)(3.0)[0])
        6.0
        >>> float(jax.jvp(lambda f: twice(f, 5.0), (2.0,), (1.0,))[1])
        5.0
    """
    fixed_leaves, fixed_tree = jax.tree.flatten(fixed)
    moving_leaves, moving_tree = jax.tree.flatten(moving)
    out_tree = jax.tree.structure(jax.eval_shape(forward, fixed, moving))

    out = _linear_map.bind(
        *map(jnp.asarray, (*fixed_leaves, *moving_leaves)),
        forward=partial(_of_leaves, forward, fixed_tree, moving_tree),
        transpose=partial(_of_leaves, transpose, fixed_tree, out_tree),
        split=len(fixed_leaves),
    )
    return out_tree.unflatten(out)


def _of_leaves(
    function: Callable, fixed_tree: Any, tree: Any, fixed: Sequence[Any], leaves: Sequence[Any]
) -> Sequence[Any]:
    """The leaves of what a function gives for trees of these leaves."""
    return jax.tree.leaves(function(fixed_tree.unflatten(fixed), tree.unflatten(list(leaves))))


def _call(*arrays: Any, forward: _Flat, transpose: _Flat, split: int) -> Sequence[Any]:
    del transpose
    return forward(arrays[:split], arrays[split:])


def _shapes(*avals: Any, **how: Any) -> list[ShapedArray]:
    out = jax.eval_shape(lambda *arrays: _call(*arrays, **how), *avals)
    return [ShapedArray(leaf.shape, leaf.dtype) for leaf in out]


def _push(primals: Any, tangents: Any, *, forward: _Flat, transpose: _Flat, split: int) -> Any:
    how = {"forward": forward, "transpose": transpose, "split": split}
    fixed, moving = primals[:split], primals[split:]
    out = _linear_map.bind(*primals, **how)
    parts = []
    if not all(isinstance(t, ad.Zero) for t in tangents[split:]):
        moved = [ad.instantiate_zeros(t) for t in tangents[split:]]
        parts.append(_linear_map.bind(*fixed, *moved, **how))
    if not all(isinstance(t, ad.Zero) for t in tangents[:split]):
        turned = [
            _no_tangent(leaf) if isinstance(t, ad.Zero) else t
            for leaf, t in zip(fixed, tangents[:split], strict=True)
        ]
        along = jax.jvp(lambda *leaves: forward(leaves, moving), tuple(fixed), tuple(turned))
        parts.append(along[1])
    return out, [sum(terms[1:], terms[0]) for terms in zip(*parts, strict=True)]


def _no_tangent(leaf: Any) -> Any:
    if jnp.issubdtype(leaf.dtype, jnp.inexact):
        return jnp.zeros_like(leaf)
    return np.zeros(leaf.shape, jax.dtypes.float0)


def _pull(cotangents: Any, *arrays: Any, forward: _Flat, transpose: _Flat, split: int) -> Any:
    back = _linear_map.bind(
        *arrays[:split],
        *(ad.instantiate_zeros(ct) for ct in cotangents),
        forward=transpose,
        transpose=forward,
        split=split,
    )
    wanted = (
        ct if ad.is_undefined_primal(a) else None
        for ct, a in zip(back, arrays[split:], strict=True)
    )
    return [*(None for _ in range(split)), *wanted]


def _batch(arrays: Any, axes: Any, *, forward: _Flat, transpose: _Flat, split: int) -> Any:
    size = next(a.shape[axis] for a, axis in zip(arrays, axes, strict=True) if axis is not None)
    moved = (
        jnp.broadcast_to(a, (size, *a.shape)) if axis is None else jnp.moveaxis(a, axis, 0)
        for a, axis in zip(arrays[split:], axes[split:], strict=True)
    )

    def over(function: _Flat) -> _Flat:
        return jax.vmap(function, in_axes=(tuple(axes[:split]), 0))

    out = _linear_map.bind(
        *arrays[:split], *moved, forward=over(forward), transpose=over(transpose), split=split
    )
    return out, [0] * len(out)


_linear_map.def_impl(_call)
_linear_map.def_abstract_eval(_shapes)
ad.primitive_jvps[_linear_map] = _push
ad.primitive_transposes[_linear_map] = _pull
batching.primitive_batchers[_linear_map] = _batch
mlir.register_lowering(_linear_map, mlir.lower_fun(_call, multiple_results=True))
