"""`converged` against direct solves: 40 of the systems of `experiments/solver_truth.py`."""

import jax.numpy as jnp
import pytest

from experiments.solver_truth import Case, cases, cells, exact, row
from mvedge_jax.diffusion import AutoSolver

pytestmark = pytest.mark.usefixtures("optimised")
CASES = [one for i, one in enumerate(cases([64], 2)) if i % 9 == 4 or one.cut < 1e-7][::3][:40]


@pytest.fixture(scope="module")
def systems():
    """Every case with its system and the exact solution."""
    made = [(case, cells(case)) for case in CASES]
    return [(case, system, exact(system)) for case, system in made]


# Never converging would be true, too.
@pytest.mark.parametrize(("dtype", "converged"), [(jnp.float32, 30), (jnp.float64, 40)])
def test_converged_is_never_a_lie(systems, dtype, converged):
    rows = [row(case, system, truth, dtype, AutoSolver()) for case, system, truth in systems]
    assert len(rows) == 40
    assert not [found for found in rows if found["wrong"]]
    assert sum(found["converged"] for found in rows) >= converged


def test_what_is_mostly_rounding_is_not_taken_for_converged():
    """A region hangs on by 1e-8, and its companion's level comes out right by luck."""
    case = Case(size=64, cut=1e-8, weight=1e6, density=1e-2, seed=56)
    system = cells(case)
    found = row(case, system, exact(system), jnp.float32, AutoSolver())
    assert found["error"] > 3
    assert not found["converged"]
    assert found["estimate"] > 1
