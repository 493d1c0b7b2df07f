"""The solvers of the package."""

from collections.abc import Callable
from typing import Any

from jaxtyping import Array

from . import _banded, _multigrid
from ._pcg import Iterate
from ._solver import AbstractSolver, ConjugateGradients, SolverState
from ._stencil import Coefficients

# Entries of the inverses of a column that are processed together: as many as fit into the fastest
# cache (512 images of 9x512, on one device: 74 ms in groups of 64, 79 of 32, 109 of 16).
_WINDOW = 64 * 9 * 9
# Largest thin images for elimination: its cost per pixel grows with the square of the short side,
# and columns are sequential.
_THIN, _SHORT = 16, 1 << 14


class Multigrid(ConjugateGradients):
    r"""Conjugate gradients with one V-cycle of multigrid, for images.

    Example:
        >>> Multigrid(tolerance=1e-6).max_iterations
        1000
    """

    def prepare(self, coefficients: Coefficients) -> _multigrid.Hierarchy:
        """All levels, with operator-dependent interpolation."""
        return _multigrid.build(coefficients)

    def preconditioner(self, hierarchy: Any) -> Callable[[Array], Array]:
        """One V-cycle."""
        return _multigrid.cycle(hierarchy)


class Elimination(AbstractSolver):
    """Exact elimination: for images with a short side, such as epipolar-plane images.

    One step suffices; its estimate is a measured bound of the rounding error. With a negative
    weight, or a tolerance below that bound (4e-6 in float32), the residual is substituted again.

    `max_iterations` is the largest number of substitutions.
    """

    def prepare(self, coefficients: Coefficients) -> tuple[()]:
        """Nothing: inverses take `h` times the memory of an image, so solves recompute them."""
        return ()

    def iterate(
        self, state: SolverState, right: Array, absolute: Array, relative: Array
    ) -> Iterate:
        """Elimination and substitutions; see `AbstractSolver.iterate`."""
        return _banded.refine(
            state.coefficients,
            right,
            state.keep,
            absolute,
            relative,
            by_residual=self.by_residual,
            max_iterations=self.max_iterations,
        )

    def together(self, shape: tuple[int, int]) -> int:
        """As many images as fit into the fastest cache."""
        return max(_WINDOW // min(shape) ** 2, 1)


class AutoSolver(AbstractSolver):
    """`Multigrid`, or `Elimination` where the short side has at most 16 of at most 16384 pixels.

    Example:
        >>> type(AutoSolver().chosen((9, 512))).__name__
        'Elimination'
    """

    def chosen(self, shape: tuple[int, ...]) -> AbstractSolver:
        """The solver for images of a shape, with the same options."""
        y, x = shape[-2:]
        thin = min(y, x) <= _THIN and y * x <= _SHORT
        kind = Elimination if thin else Multigrid
        return kind(self.tolerance, self.by_residual, self.max_iterations)

    def prepare(self, coefficients: Coefficients) -> Any:
        """As the chosen solver."""
        return self.chosen(coefficients.weight.shape).prepare(coefficients)

    def iterate(
        self, state: SolverState, right: Array, absolute: Array, relative: Array
    ) -> Iterate:
        """As the chosen solver; see `AbstractSolver.iterate`."""
        return self.chosen(right.shape).iterate(state, right, absolute, relative)

    def together(self, shape: tuple[int, int]) -> int:
        """As the chosen solver."""
        return self.chosen(shape).together(shape)
