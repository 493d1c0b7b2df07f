"""`converged` against direct solves: 40 of the systems of `experiments/solver_truth.py`."""

import jax
import jax.numpy as jnp
import pytest

from experiments.solver_truth import Case, cases, cells, exact, row
from mvedge_jax.diffusion import AutoSolver

pytestmark = pytest.mark.usefixtures("optimised")
CASES = [one for i, one in enumerate(cases([64], 2)) if i % 9 == 4 or one.cut < 1e-7][::3][:40]


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_converged_is_never_a_lie(dtype):
    rows = []
    for case in CASES:
        system = cells(case)
        rows.append(row(case, system, exact(system), dtype, AutoSolver()))
    jax.clear_caches()
    assert len(rows) == 40
    wrong = [found for found in rows if found["wrong"]]
    assert not wrong
    # Never converging would be true, too.
    assert sum(found["converged"] for found in rows) >= (40 if dtype == jnp.float64 else 30)


def test_what_is_mostly_rounding_is_not_taken_for_converged():
    """A region hangs on by 1e-8, and its companion's level comes out right by luck."""
    case = Case(size=64, cut=1e-8, weight=1e6, density=1e-2, seed=56)
    system = cells(case)
    found = row(case, system, exact(system), jnp.float32, AutoSolver())
    assert found["error"] > 3
    assert not found["converged"]
    assert found["estimate"] > 1
