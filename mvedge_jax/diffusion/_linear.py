"""The system as an operator of Lineax."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from ._stencil import Coefficients, diagonal, product
from ._system import System


class SystemOperator(lx.AbstractLinearOperator):
    """The matrix of a `System`, matrix-free: symmetric, positive semidefinite.

    Attributes:
        coefficients: data weights and edges.
    """

    coefficients: Coefficients

    def mv(self, vector: Float[Array, "y x"]) -> Float[Array, "y x"]:
        """The matrix times an image."""
        return product(self.coefficients, vector)

    def as_matrix(self) -> Float[Array, "n n"]:
        """The dense matrix, rows in the order of `ravel()`: for small images."""
        shape = self.coefficients.weight.shape
        size = self.coefficients.weight.size
        identity = jnp.eye(size, dtype=self.coefficients.weight.dtype)
        return jax.vmap(lambda image: self.mv(image.reshape(shape)).ravel())(identity)

    def transpose(self) -> "SystemOperator":
        """The same operator."""
        return self

    def in_structure(self) -> jax.ShapeDtypeStruct:
        """Shape and type of the images."""
        weight = self.coefficients.weight
        return jax.ShapeDtypeStruct(weight.shape, weight.dtype)

    def out_structure(self) -> jax.ShapeDtypeStruct:
        """As `in_structure`."""
        return self.in_structure()


def linear_operator(system: System) -> SystemOperator:
    """The matrix of a system as an operator, for solvers of this package and of Lineax.

    Args:
        system: the weights; labels are not used.

    Returns:
        An operator from images `[y, x]` to images, symmetric and positive semidefinite.
        Differentiable with respect to the weights.

    Example:
        >>> import jax.numpy as jnp
        >>> import lineax as lx
        >>> from mvedge_jax.diffusion import Multigrid
        >>> system = System(jnp.ones((2, 2)), jnp.ones((2, 2)), jnp.ones((2, 1)), jnp.ones((1, 2)))
        >>> operator, right = linear_operator(system), system.right_hand_side()
        >>> lx.linear_solve(operator, right, Multigrid()).value.round(2).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
        >>> lx.linear_solve(operator, right, lx.CG(1e-5, 1e-5)).value.round(2).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
    """
    return SystemOperator(system.coefficients)


def _same(operator: SystemOperator) -> SystemOperator:
    return operator


def _yes(_: SystemOperator) -> bool:
    return True


def _no(_: SystemOperator) -> bool:
    return False


def _diagonal(operator: SystemOperator) -> Any:
    return diagonal(operator.coefficients).ravel()


def _materialized(operator: SystemOperator) -> lx.AbstractLinearOperator:
    image, shape = operator.in_structure(), operator.coefficients.weight.shape
    matrix = operator.as_matrix().reshape(*shape, *shape)
    tags = frozenset({lx.symmetric_tag, lx.positive_semidefinite_tag})
    return lx.PyTreeLinearOperator(matrix, image, tags)


for _question in (lx.is_symmetric, lx.is_positive_semidefinite):
    _question.register(SystemOperator)(_yes)
for _question in (
    lx.is_diagonal,
    lx.is_tridiagonal,
    lx.is_lower_triangular,
    lx.is_upper_triangular,
    lx.is_negative_semidefinite,
    lx.has_unit_diagonal,
):
    _question.register(SystemOperator)(_no)
for _change in (lx.linearise, lx.conj):
    _change.register(SystemOperator)(_same)
lx.diagonal.register(SystemOperator)(_diagonal)
lx.materialise.register(SystemOperator)(_materialized)
