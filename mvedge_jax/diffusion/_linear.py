"""The system as an operator of Lineax."""

import jax
import lineax as lx

from ._system import System


def linear_operator(system: System) -> lx.FunctionLinearOperator:
    """The matrix of a system, tagged symmetric and positive semidefinite, for any Lineax solver.

    Args:
        system: the weights; labels are not used.

    Returns:
        An operator from images `[y, x]` to images. Differentiable.

    Example:
        >>> import jax.numpy as jnp
        >>> import lineax as lx
        >>> system = System(jnp.ones((2, 2)), jnp.ones((2, 2)), jnp.ones((2, 1)), jnp.ones((1, 2)))
        >>> operator = linear_operator(system)
        >>> solution = lx.linear_solve(operator, system.right_hand_side(), lx.CG(1e-5, 1e-5))
        >>> solution.value.round(2).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
    """
    image = jax.ShapeDtypeStruct(system.weight.shape, system.weight.dtype)
    tags = frozenset({lx.symmetric_tag, lx.positive_semidefinite_tag})
    return lx.FunctionLinearOperator(system.matvec, image, tags)
