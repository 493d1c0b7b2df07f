"""The Poisson system that turns sparse labels into dense maps (Thesis 4.2.2, 6.1, 7.1.1)."""

from ._diffuse import adjoint_solve as adjoint_solve, diffuse as diffuse
from ._linear import linear_operator as linear_operator
from ._solver import Diffused as Diffused, Solver as Solver, SolveStats as SolveStats
from ._system import System as System
from ._weights import edge_weights as edge_weights
