"""Solvers beside those of `mvedge_jax.diffusion`: the thesis' own, and the plainest."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from mvedge_jax.diffusion import Coefficients, ConjugateGradients, diagonal

from . import _lahbpcg


class HierarchicalBasis(ConjugateGradients):
    """Conjugate gradients with the locally adapted hierarchical basis of the thesis (LAHBPCG).

    Attributes:
        tolerance: where to stop, a share of the range of the labels; see `AbstractSolver`.
        by_residual: stop by the residual instead.
        max_iterations: steps at most.

    Source: Thesis 6.1 and 7.1.1.

    Example:
        >>> import jax.numpy as jnp
        >>> from mvedge_jax.diffusion import System, diffuse
        >>> system = System(jnp.ones((2, 2)), jnp.ones((2, 2)), jnp.ones((2, 1)), jnp.ones((1, 2)))
        >>> diffuse(system, solver=HierarchicalBasis()).value.round(2).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
    """

    def prepare(self, coefficients: Coefficients) -> _lahbpcg.Basis:
        """Incomplete factors, half an octave at a time."""
        return _lahbpcg.build(coefficients)

    def preconditioner(self, hierarchy: Any) -> Callable[[Array], Array]:
        """The product with the inverse of the incomplete factors."""
        return _lahbpcg.solver(hierarchy)


class Jacobi(ConjugateGradients):
    """Conjugate gradients with the diagonal: a baseline.

    Attributes:
        tolerance: where to stop, a share of the range of the labels; see `AbstractSolver`.
        by_residual: stop by the residual instead.
        max_iterations: steps at most.
    """

    def prepare(self, coefficients: Coefficients) -> Array:
        """The diagonal."""
        return diagonal(coefficients)

    def preconditioner(self, hierarchy: Any) -> Callable[[Array], Array]:
        """Division by the diagonal, 0 where that is."""
        known = hierarchy > 0
        return lambda residual: jnp.where(known, residual / jnp.where(known, hierarchy, 1), 0)
