"""The interface of solvers, and the statistics of a solve."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import cast, number, readable

from ._batches import mapped
from ._linear import SystemOperator
from ._pcg import Iterate, pcg
from ._stencil import Coefficients, inner, largest, reachable, spread


class SolverState(NamedTuple):
    """A prepared matrix, independent of the right-hand side.

    Attributes:
        coefficients: the matrix.
        hierarchy: result of `prepare`.
        keep: pixels that positive edges connect with data; elsewhere the matrix is singular.
    """

    coefficients: Coefficients
    hierarchy: Any
    keep: Array


class AbstractSolver(lx.AbstractLinearSolver[SolverState]):
    r"""A solver of `System`s, for `diffuse` and, with `linear_operator`, for Lineax.

    `converged` is a guarantee: the error is below the bound. If the number format cannot guarantee
    it, `converged` is False.

    Attributes:
        tolerance: bound of the error, traced. The largest error of the solution, in the unit of
            the labels, is below `tolerance` times the range of the labels or, in solves for
            derivatives, times the largest entry of the solution.
        by_residual: stop when the norm of the residual is below `tolerance` times the norm of the
            right-hand side instead, which is how solvers are usually compared. It says little
            about the error if data weights differ by orders of magnitude.
        max_iterations: steps at most.
    """

    tolerance: Float[Array, ""] | float = number(1e-4, threshold=True)
    by_residual: bool = eqx.field(static=True, default=False)
    max_iterations: int = eqx.field(static=True, default=1000)

    def __check_init__(self) -> None:
        if self.max_iterations < 1:
            raise ValueError(f"`max_iterations` must be positive; it is {self.max_iterations}.")

    @abc.abstractmethod
    def prepare(self, coefficients: Coefficients) -> Any:
        """The hierarchy of a matrix, or of some on a leading axis."""

    @abc.abstractmethod
    def iterate(
        self, state: SolverState, right: Array, absolute: Array, relative: Array
    ) -> Iterate:
        """Solves from zero until the measure of error is below `absolute + relative max |x|`.

        Args:
            state: of one matrix, or of some on a leading axis.
            right: right-hand sides, zero where the matrix is singular.
            absolute: part of the threshold, unit of the solution, or of `right` if residuals are
                measured.
            relative: part of the threshold, as a share of the largest entry of the solution.

        Returns:
            The solution and its statistics.
        """

    @abc.abstractmethod
    def together(self, shape: tuple[int, int]) -> int:
        """Number of images of a size to solve at once under `vmap`."""

    def init(self, operator: Any, options: dict[str, Any]) -> SolverState:
        """Prepares a matrix.

        Args:
            operator: made by `linear_operator`.
            options: none are read.

        Returns:
            The input of `compute`.

        Raises:
            TypeError: the operator is another one.
        """
        del options
        if not isinstance(operator, SystemOperator):
            raise TypeError(
                f"`{type(self).__name__}` solves what `linear_operator(system)` returns; "
                f"`operator` is a `{type(operator).__name__}`."
            )
        coefficients = operator.coefficients
        return SolverState(coefficients, *mapped(_prepare, choices(self))(coefficients))

    def compute(
        self, state: SolverState, vector: Float[Array, "y x"], options: dict[str, Any]
    ) -> tuple[Array, lx.RESULTS, dict[str, Any]]:
        """Solves for a right-hand side of any size.

        Args:
            state: of the matrix.
            vector: right-hand side, `[y, x]`.
            options: none are read.

        Returns:
            The solution, 0 where nothing ties a pixel to data; `lineax.RESULTS`; steps and the
            measure of error that was compared with the tolerance, unit of the solution.
        """
        del options
        tolerance = jnp.asarray(cast(self.tolerance, vector.dtype))
        iterate = solve(self, state, vector, jnp.zeros_like(tolerance), tolerance)
        kind = lx.RESULTS.where(
            iterate.iterations < self.max_iterations,
            lx.RESULTS.stagnation,
            lx.RESULTS.max_steps_reached,
        )
        kind = lx.RESULTS.where(iterate.converged, lx.RESULTS.successful, kind)
        isolated = jnp.any(~state.keep & (vector != 0))
        result = lx.RESULTS.where(isolated, lx.RESULTS.singular, kind)
        stats = {
            "num_steps": iterate.iterations,
            "max_steps": self.max_iterations,
            "estimate": iterate.estimate,
        }
        return iterate.value, result, stats

    def transpose(
        self, state: SolverState, options: dict[str, Any]
    ) -> tuple[SolverState, dict[str, Any]]:
        """The same: the matrix is symmetric."""
        return state, options

    def conj(
        self, state: SolverState, options: dict[str, Any]
    ) -> tuple[SolverState, dict[str, Any]]:
        """The same: the matrix is real."""
        return state, options

    def assume_full_rank(self) -> bool:
        """Yes; pixels that nothing ties to data stay 0."""
        return True


class ConjugateGradients(AbstractSolver):
    """Conjugate gradients with a preconditioner of the subclass.

    A subclass has `prepare`, which is called once per matrix, and `preconditioner`.

    Example:
        >>> from mvedge_jax.diffusion import System, diagonal, diffuse
        >>> class Diagonal(ConjugateGradients):
        ...     def prepare(self, coefficients):
        ...         return diagonal(coefficients)
        ...     def preconditioner(self, hierarchy):
        ...         return lambda residual: residual / hierarchy
        >>> system = System(jnp.ones((2, 2)), jnp.ones((2, 2)), jnp.ones((2, 1)), jnp.ones((1, 2)))
        >>> diffuse(system, solver=Diagonal()).value.round(2).tolist()
        [[1.0, 1.0], [1.0, 1.0]]
    """

    @abc.abstractmethod
    def preconditioner(self, hierarchy: Any) -> Callable[[Array], Array]:
        """The approximate inverse, symmetric and positive definite."""

    def iterate(
        self, state: SolverState, right: Array, absolute: Array, relative: Array
    ) -> Iterate:
        """Conjugate gradients; see `AbstractSolver.iterate`."""
        return pcg(
            state.coefficients,
            self.preconditioner(state.hierarchy),
            right,
            state.keep,
            absolute,
            relative,
            by_residual=self.by_residual,
            max_iterations=self.max_iterations,
        )

    def together(self, shape: tuple[int, int]) -> int:
        """Enough small images to make operations long."""
        return max(_TOGETHER // (shape[0] * shape[1]), 1)


# Pixels solved together under `vmap`. Images of more than half of that are solved one after the
# other: each stops on its own and stays in the cache. Smaller ones share operations, to make these
# long; larger groups leave the cache and wait for the slowest member.
_TOGETHER = 1 << 14


def choices(solver: AbstractSolver) -> AbstractSolver:
    """The solver without its numbers: a hashable key of compiled solvers."""
    return jax.tree.map(lambda _: 0.0, solver)


def solve(
    solver: AbstractSolver, state: SolverState, right: Array, absolute: Array, relative: Array
) -> Iterate:
    """Solves for a right-hand side of any size: squares of 1e-20 are lost in float32.

    Arguments are those of `AbstractSolver.iterate`, but `relative` is a share of the norm of
    `right` if residuals are measured; the tolerance of the solver is not read. The solution is NaN
    if `right` or the matrix is not finite, and 0 where the matrix is singular.
    """
    right = jnp.where(state.keep, right, 0)
    size = spread(largest(right))
    size = jnp.where(size > 0, size, 1)
    unit, scale = right / size, size[..., 0, 0]
    absolute = absolute / scale
    if solver.by_residual:
        absolute = absolute + relative * jnp.sqrt(inner(unit, unit))
        relative = jnp.zeros_like(relative)
    iterate = mapped(_iterate, choices(solver))(state, unit, absolute, relative)
    # Sums, because maxima lose NaN on some CPUs.
    sound = jnp.isfinite(jnp.sum(right) + sum(jnp.sum(maps) for maps in state.coefficients))
    return iterate._replace(
        value=jnp.where(sound, iterate.value * size, jnp.nan),
        estimate=iterate.estimate * scale,
        converged=iterate.converged & sound,
    )


def _prepare(solver: AbstractSolver, coefficients: Coefficients) -> tuple[Any, Array]:
    return solver.prepare(coefficients), reachable(coefficients)


def _iterate(
    solver: AbstractSolver, state: SolverState, right: Array, absolute: Array, relative: Array
) -> Iterate:
    return solver.iterate(state, jnp.where(state.keep, right, 0), absolute, relative)


class SolveStats(eqx.Module):
    """Statistics of a solve.

    Attributes:
        iterations: steps of conjugate gradients.
        residual: norm of the true residual over the norm of the right-hand side, both without
            the mean label.
        estimate: the number that was compared with the tolerance: the estimated largest error in
            the unit of the labels, or the residual with `by_residual`. NaN for solvers of Lineax.
        converged: whether the tolerance was reached. False for NaN in the system.
        isolated: number of pixels without a path of positive edges to any data.
    """

    iterations: Int[Array, ""]
    residual: Float[Array, ""]
    estimate: Float[Array, ""]
    converged: Bool[Array, ""]
    isolated: Int[Array, ""]

    def __repr__(self) -> str:
        return readable(self)


class Diffused(eqx.Module):
    """A dense map with the statistics of its solve.

    Attributes:
        value: the solution, in the unit of the labels.
        stats: iterations, residual, estimated error, convergence.
    """

    value: Float[Array, "y x"]
    stats: SolveStats
