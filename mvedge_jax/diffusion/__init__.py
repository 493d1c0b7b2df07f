"""The Poisson system that turns sparse labels into dense maps (Thesis 4.2.2, 6.1, 7.1.1)."""

from ._diffuse import diffuse as diffuse
from ._linear import linear_operator as linear_operator
from ._solver import (
    AbstractSolver as AbstractSolver,
    ConjugateGradients as ConjugateGradients,
    Diffused as Diffused,
    SolveStats as SolveStats,
)
from ._solvers import (
    AutoSolver as AutoSolver,
    Elimination as Elimination,
    Multigrid as Multigrid,
)
from ._stencil import Coefficients as Coefficients, diagonal as diagonal
from ._system import System as System
from ._weights import Pairing as Pairing, edge_weights as edge_weights
