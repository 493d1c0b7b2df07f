"""Options and statistics of the solver."""

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import number

_PRECONDITIONERS = ("auto", "multigrid", "banded", "lahbpcg", "jacobi")
_STOPS = ("error", "residual")


class Solver(eqx.Module):
    r"""How to solve a `System`.

    Attributes:
        tolerance: where to stop, traced; see `stop`.
        preconditioner: `"multigrid"` (one V-cycle), `"banded"` (exact elimination, for images
            with a short side, such as epipolar-plane images), `"lahbpcg"` (the locally adapted
            hierarchical basis of the thesis) or `"jacobi"` (the diagonal; a baseline). `"auto"`
            takes `"banded"` where the short side has at most 16 of at most 16384 pixels, and
            `"multigrid"` otherwise.
        stop: `"error"` stops when the estimated largest error of the solution, in the unit of
            the labels, is below `tolerance` times the range of the labels. `"residual"` stops when
            the norm of the residual is below `tolerance` times the norm of the right-hand side,
            which is how solvers are usually compared and says little about the error where data
            weights differ by orders of magnitude.
        max_iterations: steps of conjugate gradients at most.

    Example:
        >>> Solver(tolerance=1e-6).preconditioner
        'auto'
    """

    tolerance: Float[Array, ""] | float = number(1e-4)
    preconditioner: str = eqx.field(static=True, default="auto")
    stop: str = eqx.field(static=True, default="error")
    max_iterations: int = eqx.field(static=True, default=1000)

    def __check_init__(self) -> None:
        for name, options in (("preconditioner", _PRECONDITIONERS), ("stop", _STOPS)):
            if getattr(self, name) not in options:
                raise ValueError(
                    f"`{name}` must be one of {options}; it is {getattr(self, name)!r}."
                )
        if self.max_iterations < 1:
            raise ValueError(f"`max_iterations` must be positive; it is {self.max_iterations}.")


class SolveStats(eqx.Module):
    """How a solve went.

    Attributes:
        iterations: steps of conjugate gradients.
        residual: norm of the true residual over the norm of the right-hand side, both without
            the mean label.
        estimate: the number that was compared with the tolerance: with `stop="error"` the
            estimated largest error in the unit of the labels.
        converged: whether the tolerance was reached. False for NaN in the system.
        isolated: number of pixels without a path of positive edges to any data.
    """

    iterations: Int[Array, ""]
    residual: Float[Array, ""]
    estimate: Float[Array, ""]
    converged: Bool[Array, ""]
    isolated: Int[Array, ""]


class Diffused(eqx.Module):
    """A dense map and how it was found.

    Attributes:
        value: the solution, in the unit of the labels.
        stats: iterations, residual, estimated error, convergence.
    """

    value: Float[Array, "y x"]
    stats: SolveStats
