"""The same diffusion with a forward-mode rule, for Gauss-Newton and Hessians."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ._core import Options, prepare
from ._diffuse import arranged, forward, solve_adjoint
from ._solver import Diffused, Solver
from ._stencil import Coefficients, product
from ._system import System, inflow


def diffuse_forward_mode(
    system: System, *, start: Float[Array, "y x"] | None = None, solver: Solver | None = None
) -> Diffused:
    r"""Solves like `diffuse`, and can be differentiated in forward mode.

    `jax.custom_vjp`, on which `diffuse` rests, has no forward mode. Here the tangent solves
    $A \dot D = \dot w (s - D) + w \dot s - L_{\dot t} D$. As that solve knows its own transpose,
    reverse mode and higher derivatives work too; they build the hierarchy once more, which
    `diffuse` does not.

    Args:
        system: as in `diffuse`.
        start: as in `diffuse`.
        solver: as in `diffuse`.

    Returns:
        The same values and statistics as `diffuse`. Differentiable with respect to the maps of
        `system`; the statistics have no derivative.

    Raises:
        ValueError: as `diffuse`.
        TypeError: as `diffuse`.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> system = System(jnp.ones((1, 2)), jnp.ones((1, 2)), jnp.ones((1, 1)), jnp.ones((0, 2)))
        >>> def value(scale):
        ...     labels = scale * system.label
        ...     return diffuse_forward_mode(System(system.weight, labels, *system.edges)).value
        >>> jax.jvp(value, (2.0,), (1.0,))[1].tolist()
        [[1.0, 1.0]]
    """
    return _jitted(*arranged(system, start, solver))


@partial(jax.jit, static_argnums=0)
def _jitted(options: Options, system: System, start: Array | None, tolerance: Array) -> Diffused:
    return _diffuse(options, system, start, tolerance)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _diffuse(options: Options, system: System, start: Array | None, tolerance: Array) -> Diffused:
    return forward(options, system, start, tolerance)[0]


@_diffuse.defjvp
def _tangent(options: Options, primals: Any, tangents: Any) -> tuple[Diffused, Diffused]:
    system, _, tolerance = primals
    moving: System = tangents[0]
    diffused = _diffuse(options, *primals)
    value = diffused.value
    label = jnp.where(jnp.isfinite(system.label), system.label, value)
    none = jnp.zeros_like(value)
    edges = Coefficients(none, moving.tx, moving.ty)
    right = moving.weight * (label - value) + system.weight * moving.label - product(edges, value)
    if system.rise_x is not None:
        right = right + inflow(_with_rises(moving, system)) + inflow(_with_rises(system, moving))
    fixed = jax.tree.map(lax.stop_gradient, system.coefficients)
    prepared = prepare(options, fixed)
    right = jnp.where(prepared.keep, right, 0)
    solution = lax.custom_linear_solve(
        lambda image: product(system.coefficients, image),
        right,
        lambda _, image: solve_adjoint(options, prepared, image, lax.stop_gradient(tolerance)),
        symmetric=True,
    )
    return diffused, Diffused(solution, jax.tree.map(_no_tangent, diffused.stats))


def _with_rises(edges: System, rises: System) -> System:
    """The edges of one system with the rises of another."""
    return System(edges.weight, edges.label, *edges.edges, rises.rise_x, rises.rise_y)


def _no_tangent(value: Array) -> Any:
    if jnp.issubdtype(value.dtype, jnp.inexact):
        return jnp.zeros_like(value)
    return np.zeros(value.shape, jax.dtypes.float0)
