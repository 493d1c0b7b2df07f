"""Traced hyperparameters: declaring them, and matching them to the data's precision."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

_Tree = TypeVar("_Tree")
_P = ParamSpec("_P")
_T = TypeVar("_T")


def as_number(value: Any) -> Any:
    """Turns a Python or NumPy number into a strongly typed JAX array and leaves arrays alone.

    A weak type would retrace a jitted function the first time that an optimizer replaces the
    value, hence the explicit dtype.
    """
    if isinstance(value, bool | int | float | tuple | list):
        return jnp.asarray(value, dtype=jnp.result_type(float))
    if isinstance(value, np.ndarray | np.generic):
        return jax_array(value)
    if isinstance(value, jax.Array) and value.weak_type:
        return jnp.asarray(value, dtype=value.dtype)
    return value


def jax_array(value: Any) -> Any:
    """A NumPy array as one of JAX, without a request for 64 bits, which JAX may warn of."""
    numeric = isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biufc"
    return jnp.asarray(value) if numeric else value


def accepts_numpy(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Has a public function take NumPy arrays, wherever they are among its arguments.

    They become JAX arrays of the precision that is switched on: float64, NumPy's default, becomes
    float32 unless `jax_enable_x64` is set.

    Example:
        >>> @accepts_numpy
        ... def same(values):
        ...     return values
        >>> isinstance(same(np.zeros(3)), jax.Array)
        True
    """

    @functools.wraps(function)
    def converted(*arguments: _P.args, **options: _P.kwargs) -> _T:
        given = arguments, options
        if any(isinstance(leaf, np.ndarray | np.generic) for leaf in jax.tree.leaves(given)):
            arguments, options = jax.tree.map(jax_array, given)
        return function(*arguments, **options)

    return converted


def number(
    default: float | tuple[float, ...] | Callable[[], Any],
    unit: str = "",
    *,
    threshold: bool = False,
) -> Any:
    """Declares a traced numeric field of a parameter `equinox.Module`.

    Args:
        default: value, or a function without arguments that makes it. Arrays are made when the
            module is instantiated, never when the package is imported.
        unit: what it is measured in, for `describe`.
        threshold: whether it only selects or stops, so that its derivative is 0.

    Returns:
        An `equinox.field` whose value becomes an array leaf: one compiled function then serves
        every value, and `jax.grad` and `jax.vmap` reach it.

    Example:
        >>> import equinox as eqx
        >>> from jaxtyping import Array, Float
        >>> class Smoothing(eqx.Module):
        ...     sigma: Float[Array, ""] = number(0.85)
        >>> Smoothing(sigma=2.0).sigma.shape
        ()
    """
    factory = default if callable(default) else (lambda: default)
    metadata = {"unit": unit, "threshold": threshold}
    return eqx.field(converter=as_number, default_factory=factory, metadata=metadata)


def at_least(sizes: Any, **least: int) -> None:
    """Raises a ValueError for static fields that are below their bounds, or no whole numbers."""
    for name, bound in least.items():
        value = getattr(sizes, name)
        if not hasattr(value, "__index__"):
            raise ValueError(f"`{name}` must be a whole number, got {value!r}.")
        if value < bound:
            raise ValueError(f"`{name}` must be at least {bound}, got {value}.")


def positive(sizes: Any, *names: str) -> None:
    """Raises a ValueError for static fields that are not above 0, NaN included."""
    for name in names:
        value = getattr(sizes, name)
        if not value > 0:
            raise ValueError(f"`{name}` must be positive, got {value}.")


def one_of(sizes: Any, **options: tuple[Any, ...]) -> None:
    """Raises a ValueError for static fields that have none of their options."""
    for name, known in options.items():
        value = getattr(sizes, name)
        if value not in known:
            raise ValueError(f"`{name}` must be one of {known}, got {value!r}.")


# Entries of an array that `readable` still shows one by one.
_FEW = 16


def readable(record: Any) -> str:
    """A record of results with its numbers: the `__repr__` of statistics.

    Such as `SolveStats(iterations=12, converged=True)`. Traced and long arrays show their types.
    """
    if isinstance(record, eqx.Module):
        names = [field.name for field in dataclasses.fields(record)]
    else:
        names = record._fields
    parts = (f"{name}={_readable(getattr(record, name))}" for name in names)
    return f"{type(record).__name__}({', '.join(parts)})"


def _readable(value: Any) -> str:
    if isinstance(value, eqx.Module) or hasattr(value, "_fields"):
        return readable(value)
    if eqx.is_array(value) and not isinstance(value, Tracer) and value.size <= _FEW:
        return np.array2string(np.asarray(value), precision=6, separator=", ", floatmode="maxprec")
    return eqx.tree_pformat(value)


def cast(tree: _Tree, dtype: Any) -> _Tree:
    """Casts every inexact array leaf to `dtype`; other leaves are left alone. Differentiable.

    A stage calls it on its parameters with the dtype of its data, so that float32 views and float64
    parameters (the default under `jax_enable_x64`) never promote.
    """

    def convert(leaf: Any) -> Any:
        if eqx.is_inexact_array(leaf) or (
            eqx.is_array_like(leaf) and jnp.issubdtype(jnp.result_type(leaf), jnp.inexact)
        ):
            return jnp.asarray(leaf).astype(dtype)
        return leaf

    return jax.tree.map(convert, tree)
