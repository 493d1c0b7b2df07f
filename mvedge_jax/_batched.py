"""Many settings through one program, in the memory of a few."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, jaxpr_as_fun
from jax.sharding import Mesh, PartitionSpec

from ._compiler import LeanJit, lean_jit

# Largest number of rows computed together, and of numbers in their largest array on the CPU.
# Larger arrays leave the cache, and loops wait for the slowest row; with smaller ones, the
# overhead of starting operations dominates.
_MOST = 8
_NUMBERS = 1 << 17


def batched(
    function: Callable[..., Any],
    *,
    together: int | None = None,
    devices: Sequence[Any] | None = None,
) -> LeanJit[..., Any]:
    """Calls a function for many settings: `jax.vmap` of its first argument, a few rows at a time.

    Steps of the function that depend on no row are computed once, and their memory does not grow
    with the rows. Steps are whole: loops, conditionals and the chain's stages (`EdgeDepth`) that
    depend on a row are computed once per group of rows.

    Args:
        function: maps a pytree of arrays, and whatever comes after it, to a pytree of arrays.
        together: number of rows computed together; memory grows with it. By default
            at most eight: fewer on the CPU where arrays are large.
        devices: JAX devices, each of which computes an equal share of the rows, and for itself what
            depends on no row; None for the default device alone.

    Returns:
        A function of the rows, stacked on the leading axis of every leaf, and of the other
        arguments, which gives results stacked alike. Compiled as by `lean_jit`; differentiable.

    Raises:
        ValueError: `together` is below 1 or there are no `devices`; when it is called, rows have
            no leaf, or their leaves differ in their leading axis.

    Example:
        >>> squares = batched(lambda row, shift: row**2 + shift)
        >>> squares(jnp.arange(3.0), jnp.asarray(1.0)).tolist()
        [1.0, 2.0, 5.0]
    """
    if together is not None and together < 1:
        raise ValueError(f"`together` must be at least 1, got {together}.")
    if devices is not None and not devices:
        raise ValueError("`devices` must have one device at least, got none.")

    @functools.wraps(function)
    def many(rows: Any, *shared: Any) -> Any:
        arrays, static = eqx.partition(shared, eqx.is_array)

        def mapped(rows: Any, arrays: Any) -> Any:
            given = eqx.combine(arrays, static)
            return _mapped(lambda row: function(row, *given), rows, together)

        if devices is None:
            return mapped(rows, arrays)
        return _spread(mapped, rows, arrays, devices)

    return lean_jit(many)


def _spread(
    mapped: Callable[[Any, Any], Any], rows: Any, shared: Any, devices: Sequence[Any]
) -> Any:
    """Rows on several devices; the last one fills up the shares."""
    size, count = _size_of(jax.tree.leaves(rows)), len(devices)
    order = np.minimum(np.arange(-(-size // count) * count), max(size - 1, 0))
    mesh = Mesh(np.asarray(devices), ("rows",))
    split, whole = PartitionSpec("rows"), PartitionSpec()
    # The check of varying axes rejects loops that start from constants, as those of the chain do.
    run = jax.shard_map(
        mapped, mesh=mesh, in_specs=(split, whole), out_specs=split, check_vma=False
    )
    results = run(jax.tree.map(lambda leaf: leaf[order], rows), shared)
    return jax.tree.map(lambda leaf: leaf[:size], results)


def _size_of(leaves: Sequence[Any]) -> int:
    """Number of rows, if all leaves have the same."""
    sizes = {jnp.shape(leaf)[:1] for leaf in leaves}
    if len(sizes) != 1 or () in sizes:
        shapes = [jnp.shape(leaf) for leaf in leaves]
        raise ValueError(f"`rows` must have one leading axis in all of its leaves, got {shapes}.")
    ((size,),) = sizes
    return size


class _Later:
    """Placeholder of a value that depends on a row."""


class _Step(NamedTuple):
    """An equation that depends on a row, with its inputs and its output variables."""

    run: Callable[..., Sequence[Any]]
    inputs: list[Any]
    outputs: list[_Later]
    numbers: int


def _mapped(function: Callable[[Any], Any], rows: Any, together: int | None) -> Any:
    leaves, structure = jax.tree.flatten(rows)
    size = _size_of(leaves)
    if size == 0:
        return jax.vmap(function)(rows)
    one = [jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype) for leaf in leaves]
    traced, shape = jax.make_jaxpr(
        lambda leaves: function(structure.unflatten(leaves)), return_shape=True
    )(one)
    moving, steps = [_Later() for _ in leaves], list[_Step]()
    results = _split(traced.jaxpr, traced.consts, moving, steps)

    def of_row(row: list[Any]) -> list[Any]:
        values: dict[Any, Any] = dict(zip(moving, row, strict=True))
        for step in steps:
            given = [values[x] if isinstance(x, _Later) else x for x in step.inputs]
            values.update(zip(step.outputs, step.run(*given), strict=True))
        return [values[x] if isinstance(x, _Later) else jnp.asarray(x) for x in results]

    count = -(-size // (_together(steps) if together is None else together))
    group = -(-size // count)
    # The last group is filled up with the last row.
    order = np.minimum(np.arange(count * group), size - 1)
    filled = leaves if count * group == size else [leaf[order] for leaf in leaves]
    grouped = [leaf.reshape(count, group, *leaf.shape[1:]) for leaf in filled]
    stacked = lax.map(jax.vmap(of_row), grouped)
    flat = [leaf.reshape(count * group, *leaf.shape[2:])[:size] for leaf in stacked]
    return jax.tree.unflatten(jax.tree.structure(shape), flat)


def _split(
    program: Jaxpr, constants: Sequence[Any], arguments: Sequence[Any], steps: list[_Step]
) -> list[Any]:
    """Evaluates equations that depend on no row; the others are added to the steps."""
    known = dict(zip(program.constvars, constants, strict=True))
    known.update(zip(program.invars, arguments, strict=True))

    def read(atom: Any) -> Any:
        return atom.val if isinstance(atom, Literal) else known[atom]

    for equation in program.eqns:
        given = [read(atom) for atom in equation.invars]
        inner = equation.params.get("jaxpr") if equation.primitive.name == "jit" else None
        if not any(isinstance(value, _Later) for value in given):
            outputs = _alone(program, equation)(*given)
        elif inner is not None:
            outputs = _split(inner.jaxpr, inner.consts, given, steps)
        else:
            outputs = [_Later() for _ in equation.outvars]
            numbers = max((getattr(v.aval, "size", 0) for v in equation.outvars), default=0)
            steps.append(_Step(_alone(program, equation), given, outputs, numbers))
        known.update(zip(equation.outvars, outputs, strict=True))
    return [read(atom) for atom in program.outvars]


def _alone(program: Jaxpr, equation: JaxprEqn) -> Callable[..., Sequence[Any]]:
    """An equation as a function of all that it reads."""
    read = [i for i, atom in enumerate(equation.invars) if not isinstance(atom, Literal)]
    invars = [equation.invars[i] for i in read]
    one = program.replace(constvars=[], invars=invars, outvars=equation.outvars, eqns=[equation])
    function = jaxpr_as_fun(ClosedJaxpr(one, []))
    return lambda *given: function(*(given[i] for i in read))


def _together(steps: Sequence[_Step]) -> int:
    """Number of rows computed together on this device."""
    if jax.default_backend() != "cpu":
        return _MOST
    largest = max((step.numbers for step in steps), default=1)
    return min(max(_NUMBERS // max(largest, 1), 1), _MOST)
