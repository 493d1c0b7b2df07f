"""`converged` against direct solves: 40 of the systems of `experiments/solver_truth.py`."""

import jax
import jax.numpy as jnp
import pytest

from experiments.solver_truth import cases, cells, exact, row
from mvedge_jax.diffusion import AutoSolver

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
