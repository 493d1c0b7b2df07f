"""Options for XLA on the CPU, and forms of code that it compiles well.

Values equal those of the plain forms. `experiments/benchmarks/cpu_tricks.py` measures each. On
other devices they have no effect or no cost.
"""

import contextlib
import ctypes
import functools
import gc
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Shaped

from ._checkpoint import checkpoint
from ._linear_map import linear_map

_In = TypeVar("_In")
_Out = TypeVar("_Out")
# On the CPU, the newer fusion emitters cost the chain a third of the compiler's memory and a
# quarter of its run time; the concurrent order of kernels, which hardly run concurrently, costs
# two fifths of its arrays' memory. Loop optimizations beyond the first level (mostly unrolling)
# take up to a quarter of the compile time and save a fortieth of the run time.
_LEVEL = "xla_backend_optimization_level"
_WISHES = {
    _LEVEL: 1,
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}


def compiler_options() -> dict[str, bool | int | float | str]:
    """XLA options of `lean_jit` and every program of this package, for a `jax.jit` of yours.

    `EdgeDepth` and others set them when called directly; `EdgeDepth` does under `grad`, too. JAX
    applies the options of the outermost `jit` only, so within your own `jit`, yours count. The
    options change speed and memory of compiling and running on the CPU, but not the results,
    except for rounding.

    Returns:
        Options for `jax.jit(..., compiler_options=...)`; empty on other devices, or if the
        compiler does not know them.

    Example:
        >>> square = jax.jit(lambda x: x * x, compiler_options=compiler_options())
        >>> float(square(3.0))
        9.0
    """
    known = dict(_known(jax.default_backend()))
    if jax.config.read("jax_disable_most_optimizations"):
        known.pop(_LEVEL, None)
    return known


@functools.cache
def _known(backend: str) -> dict[str, bool | int | float | str]:
    if backend != "cpu":
        return {}
    try:
        jax.jit(lambda x: x, compiler_options=_WISHES).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return dict(_WISHES)


@contextlib.contextmanager
def no_collections() -> Iterator[None]:
    """Suspends the garbage collector: a trace makes millions of objects, but little garbage."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def release_memory() -> None:
    """Returns freed memory to the system, where the C library would keep it (glibc).

    The compiler frees almost a gigabyte after the whole chain; otherwise the arrays of the first
    run would be allocated in addition.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def no_fuse(function: Callable[..., Any], *arguments: Any) -> Any:
    """Calls `function` so that its results are computed once and stored.

    XLA on the CPU fuses chains of stencils and recomputes every intermediate for each of its
    readers, which grows like 9 to the power of the length of the chain. Compilers of other devices
    take this cost into account, and a conditional would wait for the device, so there it is a
    plain call.
    """
    if jax.default_backend() != "cpu":
        return function(*arguments)
    return _as_a_branch(function, *arguments)


def _as_a_branch(function: Callable[..., Any], *arguments: Any) -> Any:
    """Calls `function` in the branch of a conditional, which is compiled separately.

    A barrier alone does not help, because it is removed before fusion. Here it hides that the
    condition is constant.
    """
    shapes = jax.eval_shape(function, *arguments)
    always = lax.optimization_barrier(jnp.asarray(True))
    return lax.cond(
        always,
        function,
        lambda *_: jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes),
        *arguments,
    )


def checkpoint_stage(function: Callable[..., Any]) -> Callable[..., Any]:
    """A stage of a long computation; reverse mode stores its arguments only.

    `jax.checkpoint` alone does not determine when a stage is recomputed: XLA on the CPU may
    recompute all stages at once, long before their cotangents are available, and store everything.
    A conditional waits for its arguments, and the cotangents are among them. Differentiable in both
    modes.
    """

    def stage(*arguments: Any) -> Any:
        # Arguments that are not arrays, such as activation functions, are closed over.
        arrays, rest = eqx.partition(arguments, _is_array)

        def of_arrays(arrays: Any) -> Any:
            return function(*eqx.combine(arrays, rest))

        return _as_a_branch(checkpoint(of_arrays), arrays)

    return stage


def _is_array(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, np.ndarray)


def of_both(function: Callable[[_In], _Out], first: _In, second: _In) -> tuple[_Out, _Out]:
    """Calls a function on each of two pytrees, in a loop if all of their shapes agree.

    A loop compiles the function once, which shortens the first call. Square images in a square grid
    have two arms of one shape. The results are computed once and stored (`no_fuse`).
    """
    pair = first, second
    if len({tuple(map(jax.typeof, jax.tree.leaves(of))) for of in pair}) > 1:
        return no_fuse(function, first), no_fuse(function, second)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *pair)
    results = lax.map(function, stacked)
    across, down = (jax.tree.map(lambda leaf, i=i: leaf[i], results) for i in range(2))
    return across, down


def unstack(planes: Shaped[Array, "n *s"]) -> list[Array]:
    """The planes of a stack, as `list(planes)` has them.

    The transpose of indexing adds stacks of zeros with one plane set; that of a split is one
    concatenation.
    """
    count = planes.shape[0]
    if count == 0:
        return []
    return [lax.squeeze(part, (0,)) for part in lax.split(planes, (1,) * count)]


def plane_sum(planes: Float[Array, "n *s"]) -> Float[Array, "*s"]:
    """The sum of a stack, plane by plane: XLA on CPU does not vectorize over a leading axis.

    Its own derivative avoids that JAX assembles the planes' cotangents one by one.
    """
    return linear_map(_added, lambda _, ct: jnp.broadcast_to(ct, planes.shape), None, planes)


def _added(_: None, planes: Array) -> Array:
    parts = unstack(planes)
    return sum(parts[1:], parts[0]) if parts else jnp.zeros(planes.shape[1:], planes.dtype)


@eqx.filter_custom_jvp
def convolution(layer: eqx.nn.Conv2d, planes: Float[Array, "k y x"]) -> Float[Array, "l Y X"]:
    """`layer(planes)`, for networks within the chain; on a CPU up to ten times as fast there.

    In a loop, such as that of the solves, XLA on the CPU is slow where channels come first. Here
    they come last, but not in derivatives, whose transposes are slower that way.

    Args:
        layer: any; with groups or borders other than zeros it is called as it is.
        planes: its input.

    Returns:
        Its output. Differentiable in both.
    """
    if layer.groups != 1 or layer.padding_mode.upper() != "ZEROS":
        return layer(planes)
    found = lax.conv_general_dilated(
        jnp.moveaxis(planes, 0, -1)[None],
        jnp.transpose(layer.weight, (2, 3, 1, 0)),
        layer.stride,
        layer.padding,
        rhs_dilation=layer.dilation,
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
    )
    found = jnp.moveaxis(found[0], -1, 0)
    return found if layer.bias is None else found + layer.bias


@convolution.def_jvp
def _convolution_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    slope = eqx.filter_jvp(lambda layer, planes: layer(planes), primals, tangents)[1]
    return convolution(*primals), slope
