"""What several test files need: real data, gradient checks, trace counts."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, PRNGKeyArray

from mvedge_jax import compiler_options

_DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"


def shared_data(*parts: str) -> Path:
    """A path inside the development data; skips the test where it is absent."""
    path = _DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"development data {'/'.join(parts)} is not there (looked in {_DATA})")
    return path


def lean(function: Callable) -> Any:
    """`jax.jit` with the options of `lean_jit`: compiled in two thirds of the time."""
    return jax.jit(function, compiler_options=compiler_options())


def random_like(tree: Any, *, key: PRNGKeyArray) -> Any:
    """A tree of standard normal numbers in the shape of `tree`'s floating leaves."""
    leaves, structure = jax.tree.flatten(tree)
    keys = jax.random.split(key, max(len(leaves), 1))
    return jax.tree.unflatten(
        structure,
        [
            jax.random.normal(k, leaf.shape, leaf.dtype)
            for k, leaf in zip(keys, leaves, strict=True)
        ],
    )


def check_gradient(
    function: Callable[[Any], Array],
    tree: Any,
    *,
    rtol: float,
    step: float | None = None,
    directions: int = 3,
    key: PRNGKeyArray,
) -> None:
    """Compares `jax.grad` with central differences along random directions, in float64.

    Of `tree` only floating leaves vary. By default, the length of a step along a direction of unit
    root-mean-square is the cube root of the machine epsilon times the scale of the tree.
    """
    moving, rest = eqx.partition(tree, eqx.is_inexact_array)
    leaves = jax.tree.leaves(moving)
    assert leaves, "there is nothing to differentiate"
    assert all(leaf.dtype == jnp.float64 for leaf in leaves), "differences need float64"
    # One program for values and gradient: compiling costs more than gradients nobody looks at.
    evaluate = lean(jax.value_and_grad(lambda m: function(eqx.combine(m, rest))))
    gradient = evaluate(moving)[1]
    scale = max(float(jnp.abs(leaf).max()) if leaf.size else 0.0 for leaf in leaves)
    step = np.finfo(np.float64).eps ** (1 / 3) * max(scale, 1e-3) if step is None else step
    for direction_key in jax.random.split(key, directions):
        direction = random_like(moving, key=direction_key)

        above, below = (
            evaluate(jax.tree.map(lambda a, b, t=t: a + t * b, moving, direction))[0]
            for t in (step, -step)
        )
        numeric = float(above - below) / (2 * step)
        analytic = dot(gradient, direction)
        assert np.isfinite(analytic), "the gradient is not finite"
        error = abs(analytic - numeric) / max(abs(numeric), abs(analytic), 1e-300)
        assert error <= rtol, f"gradient {analytic:.12g}, differences {numeric:.12g}: {error:.2e}"


def count_traces(function: Callable) -> tuple[Callable, Callable[[], int]]:
    """The jitted `function`, and a function that gives the number of its traces."""
    traces = []

    def counted(*args, **kwargs):
        traces.append(None)
        return function(*args, **kwargs)

    return eqx.filter_jit(counted), lambda: len(traces)


def dot(a: Any, b: Any) -> float:
    """Inner product of two trees of one structure."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return float(sum(jnp.vdot(x, y) for x, y in pairs))


def check_modes(
    function: Callable[[Any], Array],
    tree: Any,
    *,
    rtol: float,
    step: float = 1e-6,
    key: PRNGKeyArray,
) -> None:
    """Compares grad, jvp, linearize and jvp of grad with central differences, in float64.

    Along one random direction of the floating leaves. The error of the derivative of the gradient
    is relative to its largest entry per leaf.
    """
    moving, rest = eqx.partition(tree, eqx.is_inexact_array)
    direction = random_like(moving, key=key)

    def value(m: Any) -> Array:
        return function(eqx.combine(m, rest))

    def moved(t: Any) -> Any:
        return jax.tree.map(lambda a, b: a + t * b, moving, direction)

    # One program for values, gradients and how these change: compiling is nearly all of the time.
    @lean
    def reverse(m: Any) -> Any:
        return jax.jvp(jax.value_and_grad(value), (m,), (direction,))

    (_, gradient), (_, turned) = reverse(moving)
    (above, gradient_above), (below, gradient_below) = (reverse(moved(t))[0] for t in (step, -step))
    numeric = float(above - below) / (2 * step)
    forward = float(lean(lambda m, d: jax.jvp(value, (m,), (d,))[1])(moving, direction))
    linear = float(jax.linearize(jax.jit(value), moving)[1](direction))
    for name, found in (("jvp", forward), ("grad", dot(gradient, direction)), ("linear", linear)):
        error = abs(found - numeric) / max(abs(numeric), abs(found), 1e-300)
        assert error <= rtol, f"{name} {found:.12g}, differences {numeric:.12g}: {error:.2e}"
    expected = jax.tree.map(lambda a, b: (a - b) / (2 * step), gradient_above, gradient_below)
    for (path, found), wanted in zip(
        jax.tree_util.tree_leaves_with_path(turned), jax.tree.leaves(expected), strict=True
    ):
        error = float(jnp.abs(found - wanted).max()) / max(float(jnp.abs(wanted).max()), 1e-300)
        # A NaN compares as false, too.
        assert error <= rtol, f"jvp of grad, {jax.tree_util.keystr(path)}: {error:.2e}"


def with_values(parameters: type, **values: float) -> Any:
    """Parameters with some numbers set."""
    return parameters(**{name: jnp.asarray(value) for name, value in values.items()})
