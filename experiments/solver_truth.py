"""Does the solver say the truth? `converged` and the estimate against direct solves.

    python experiments/solver_truth.py --out results/solver_truth
    python experiments/solver_truth.py --sizes 64 128 --seeds 1

The systems are random cells, tied to each other by edges down to 1e-10 of those inside, with data
weights from 1e-2 to 1e6 at 1e-4 to all of the pixels. A solve promises an error of at most the
tolerance times the range of the labels. It is *wrong* if it says converged with more than three
times that, and *needlessly pessimistic* if it says not converged with less than the promise.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse.linalg
import scipy.spatial

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments._report import print_table, write_csv, write_json
from mvedge_jax.diffusion import AutoSolver, System, diffuse

CUTS = (1.0, 1e-2, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10)
WEIGHTS = (1e-2, 1.0, 1e2, 1e4, 1e6)
DENSITIES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
# Of large images every so many systems, as a direct solve takes long.
EVERY = {64: 1, 128: 2, 256: 4, 512: 16, 1024: 60}


class Case(NamedTuple):
    """What a system is made from."""

    size: int
    cut: float
    weight: float
    density: float
    seed: int


def cases(sizes: list[int], seeds: int) -> Iterator[Case]:
    """All combinations on small images, some of them on larger ones."""
    grid = list(itertools.product(CUTS, WEIGHTS, DENSITIES))
    for size in sizes:
        for seed in range(seeds):
            # A step that shares no factor with the grid visits all of its values.
            order = [grid[(i * 37 + 11 * seed) % len(grid)] for i in range(len(grid))]
            for i, one in enumerate(order[:: EVERY.get(size, 4)]):
                yield Case(size, *one, seed=1000 * seed + i)


def cells(case: Case) -> System:
    """Voronoi cells, in float32.

    Odd seeds have cuts, and weights, of all strengths between 1 and the case's own.
    """
    random = np.random.default_rng([case.seed, case.size])
    size, mixed = case.size, case.seed % 2 == 1
    across = np.exp(random.uniform(np.log(2.5), np.log(size / 3)))
    count = max(int((size / across) ** 2), 2)
    rows, columns = np.mgrid[:size, :size]
    places = np.stack([rows.ravel(), columns.ravel()], 1)
    tree = scipy.spatial.KDTree(random.uniform(0, size, (count, 2)))
    cell = tree.query(places)[1].reshape(size, size)
    height = random.uniform(-1, 1, count)[cell] + 0.1 * random.normal(size=(size, size))

    def edges(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        share = random.uniform(size=a.shape) if mixed else 1.0
        return np.where(a == b, 1.0, case.cut**share)

    labeled = random.uniform(size=cell.shape) < case.density
    labeled[random.integers(size), random.integers(size)] = True
    share = random.uniform(size=cell.shape) if mixed else 1.0
    maps = (
        np.where(labeled, case.weight**share, 0.0),
        height,
        edges(cell[:, 1:], cell[:, :-1]),
        edges(cell[1:], cell[:-1]),
    )
    return System(*(jnp.asarray(a, jnp.float32) for a in maps))


def exact(system: System) -> np.ndarray:
    """The solution by sparse factorization, refined by residuals from differences."""
    factors = scipy.sparse.linalg.splu(
        system.to_scipy().tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    maps = (system.weight, system.label, *system.edges)
    weight, label, tx, ty = (np.asarray(a, np.float64) for a in maps)
    value = np.full(weight.shape, np.sum(weight * label) / np.sum(weight))
    for _ in range(4):
        rest = weight * (label - value)
        along_x, along_y = tx * np.diff(value, axis=1), ty * np.diff(value, axis=0)
        rest[:, :-1] += along_x
        rest[:, 1:] -= along_x
        rest[:-1] += along_y
        rest[1:] -= along_y
        value = value + factors.solve(rest.ravel()).reshape(rest.shape)
    return value


def row(case: Case, system: System, truth: np.ndarray, dtype: Any, solver: AutoSolver) -> dict:
    """How one solve went."""
    found = diffuse(jax.tree.map(lambda a: jnp.asarray(a, dtype), system), solver=solver)
    known = np.asarray(system.label, np.float64)[np.asarray(system.weight) > 0]
    promise = float(solver.tolerance) * float(np.ptp(known))
    # A single label has no range; what is promised then is the rounding of its value.
    promise += 4 * float(jnp.finfo(dtype).eps) * float(np.abs(known).max())
    error = float(np.abs(np.asarray(found.value, np.float64) - truth).max())
    converged = bool(found.stats.converged)
    return {
        **case._asdict(),
        "dtype": jnp.dtype(dtype).name,
        "error": error / promise,
        "estimate": float(found.stats.estimate) / promise,
        "converged": converged,
        "wrong": converged and not error <= 3 * promise,
        "pessimistic": not converged and error <= promise,
        "iterations": int(found.stats.iterations),
    }


def summary(rows: list[dict[str, Any]], by: str) -> list[dict[str, Any]]:
    """Counts per value of a column, float32 and float64 apart."""
    found = []
    for value, dtype in itertools.product(dict.fromkeys(r[by] for r in rows), _DTYPES):
        some = [r for r in rows if r[by] == value and r["dtype"] == dtype]
        if some:
            found.append({
                by: value,
                "dtype": dtype,
                "systems": len(some),
                "converged": sum(r["converged"] for r in some),
                "wrong": sum(r["wrong"] for r in some),
                "needlessly pessimistic": sum(r["pessimistic"] for r in some),
                "not solved": sum(not r["error"] <= 1 for r in some),
                "iterations, median": float(np.median([r["iterations"] for r in some])),
                "most": max(r["iterations"] for r in some),
                "worst error if converged": max(
                    (r["error"] for r in some if r["converged"]), default=0.0
                ),
            })  # fmt: skip
    return found


_DTYPES = ("float32", "float64")


def main() -> None:
    """Solves all systems in both precisions and prints the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="*", default=list(EVERY))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--tolerance", type=float, default=1e-4)
    parser.add_argument("--out", type=Path, default=Path("results/solver_truth"))
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    solver = AutoSolver(tolerance=arguments.tolerance)
    rows, start = [], time.perf_counter()
    for case in cases(arguments.sizes, arguments.seeds):
        system = cells(case)
        truth = exact(system)
        rows += [row(case, system, truth, dtype, solver) for dtype in _DTYPES]
        if any(r["wrong"] for r in rows[-2:]):
            print(rows[-2:], flush=True)
        if len(rows) % 50 == 0:
            write_json(arguments.out / "solver_truth.json", rows)
    for by in ("size", "cut", "weight", "density"):
        print_table(summary(rows, by), title=f"by {by}")
    every = [r | {"all": "all"} for r in rows]
    print_table(summary(every, "all"), title=f"{time.perf_counter() - start:.0f} s")
    write_json(arguments.out / "solver_truth.json", rows)
    write_csv(arguments.out / "solver_truth.csv", rows)


if __name__ == "__main__":
    main()
