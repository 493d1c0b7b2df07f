"""The diffusion solver against direct and multigrid solvers that a user could pick.

All solvers get the same systems in one run: `data/poisson` where it is present, and generated
ones (labels at image edges, smoothness from gradients, contrast 1 to 1e9). Setup counts: what is
compared is the time from weights and labels to a map.

    python experiments/benchmarks/diffusion.py --out results/diffusion
    python experiments/benchmarks/diffusion.py --only ours --sizes 128 512 2048
    python experiments/benchmarks/diffusion.py --only batches --devices 2
"""

import argparse
import importlib
import itertools
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
import scipy.sparse.linalg
from jax.sharding import NamedSharding, PartitionSpec

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import peak_memory, print_table, shared_data, write_csv, write_json  # noqa: E402
from peers.solvers import HierarchicalBasis, Jacobi  # noqa: E402

from mvedge_jax.diffusion import (
    AbstractSolver,
    AutoSolver,
    Multigrid,
    System,
    diffuse,
    edge_weights,
    linear_operator,
)


class Problem(NamedTuple):
    """A system in float32 and, if it is known, its exact solution."""

    name: str
    system: System
    exact: np.ndarray | None


class Answer(NamedTuple):
    """Seconds for setup and solve, iterations (if any) and the map."""

    setup: float
    solve: float
    iterations: int | None
    value: np.ndarray


def generate(size: int, contrast: float, *, seed: int = 0) -> System:
    """Labels at the edges of a picture of discs, smoothness from its gradient.

    Args:
        size: side, px; the discs grow with it, so that one family has one shape.
        contrast: largest over smallest smoothness.
        seed: of the picture.
    """
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[:size, :size] / size
    picture, depth = np.zeros((size, size)), np.zeros((size, size))
    for _ in range(30):
        y, x, radius = *random.uniform(0, 1, 2), random.uniform(0.03, 0.2)
        inside = (rows - y) ** 2 + (columns - x) ** 2 < radius**2
        picture[inside], depth[inside] = random.uniform(0, 1), random.uniform(-1.5, 1.5)
    picture += 0.05 * scipy.ndimage.gaussian_filter(random.normal(size=picture.shape), 1.0)
    gradient = np.hypot(scipy.ndimage.sobel(picture, 0), scipy.ndimage.sobel(picture, 1))
    steepness = np.clip(gradient / np.quantile(gradient, 0.99), 0, 1)
    smoothness = contrast**-steepness
    labeled = (steepness > 0.3) & (random.uniform(size=picture.shape) < 0.3)
    weight = np.where(labeled, 1.0, 0.0)
    arrays = (jnp.asarray(a, jnp.float32) for a in (weight, depth, smoothness))
    weight, label, smoothness = arrays
    return System(weight, label, *edge_weights(smoothness))


def problems(sizes: list[int], contrasts: list[float], real: bool) -> Iterator[Problem]:
    """The real systems, then the generated ones."""
    folder = shared_data()
    if real and folder is not None and (folder / "poisson").is_dir():
        for path in sorted((folder / "poisson").glob("*.npz")):
            data = np.load(path)
            maps = (data["w"], data["d"], data["sx"][:, 1:], data["sy"][1:])
            system = System(*(jnp.asarray(a, jnp.float32) for a in maps))
            yield Problem(path.stem, system, data["x"])
    for size in sizes:
        for contrast in contrasts:
            yield Problem(f"discs_{size}_c{contrast:.0e}", generate(size, contrast), None)


def ours(kind: type[AbstractSolver], repeats: int) -> Callable[[System, float], Answer]:
    """One of our solvers. Setup is part of the compiled function and counts as solve."""

    def run(system: System, tolerance: float) -> Answer:
        solver = kind(tolerance, by_residual=True, max_iterations=20000)
        function = jax.jit(lambda system: diffuse(system, solver=solver))
        result = jax.block_until_ready(function(system))
        seconds = repeat(lambda: jax.block_until_ready(function(system)), repeats)
        return Answer(0.0, seconds, int(result.stats.iterations), np.asarray(result.value))

    return run


def epipolar_images(count: int = 512, views: int = 9, width: int = 512, *, seed: int = 0) -> System:
    """A batch of epipolar-plane images with slanted edges and labels at nine pixels in ten.

    Smoothness follows the gradient as in the angular diffusion of Thesis 6.1, from 1e4 down.
    """
    random = np.random.default_rng(seed)
    steps, columns = np.arange(views)[:, None] - views // 2, np.arange(width)[None]
    weight = np.where(random.uniform(size=(count, views, width)) < 0.9, 15.0, 0.0)
    weight[:, views // 2] = 5.0
    label, smoothness = np.zeros_like(weight), np.zeros_like(weight)
    for i in range(count):
        gradient = np.zeros((views, width))
        for _ in range(25):
            slope, start = random.uniform(-1.5, 1.5), random.uniform(0, width)
            edge = start - steps * slope
            strength = random.exponential(10) * np.clip(1.5 - np.abs(columns - edge), 0, None)
            gradient = np.maximum(gradient, strength)
            label[i] = np.where(columns > edge, slope, label[i])
        smoothness[i] = 0.1 / (gradient**2 + 1e-5)
    tx = np.minimum(smoothness[..., 1:], smoothness[..., :-1])
    ty = np.minimum(smoothness[:, 1:], smoothness[:, :-1])
    return System(*(jnp.asarray(a, jnp.float32) for a in (weight, label, tx, ty)))


def batches_and_gradients(repeats: int) -> list[dict[str, Any]]:
    """A batch of thin systems under `vmap`, and what a gradient costs next to a solve."""
    rows = []
    systems = epipolar_images()
    exact = [
        scipy.sparse.linalg.spsolve(
            one.to_scipy().tocsc(), np.asarray(one.right_hand_side()).ravel()
        )
        for one in (jax.tree.map(lambda maps, i=i: maps[i], systems) for i in (0, 255))
    ]
    # A device of the CPU is one core as far as loops are concerned.
    mesh = jax.make_mesh((jax.device_count(),), ("batch",))
    spread = jax.device_put(systems, NamedSharding(mesh, PartitionSpec("batch")))
    counts = [1] if jax.device_count() == 1 else [1, jax.device_count()]
    for by_residual, devices in itertools.product((True, False), counts):
        what = "residual" if by_residual else "error"
        solver = AutoSolver(tolerance=1e-5, by_residual=by_residual)
        each = jax.vmap(lambda system, solver=solver: diffuse(system, solver=solver))
        split = PartitionSpec("batch")
        several = jax.shard_map(each, mesh=mesh, in_specs=split, out_specs=split, check_vma=False)
        function, batch = (each, systems) if devices == 1 else (several, spread)
        function = jax.jit(function)
        found = jax.block_until_ready(function(batch))
        seconds = repeat(lambda f=function, b=batch: jax.block_until_ready(f(b)), repeats)
        errors = [
            np.abs(np.asarray(found.value)[i].ravel() - e).max()
            for i, e in zip((0, 255), exact, strict=True)
        ]
        rows.append({
            "task": f"512 images of 9x512, 1e-5 of the {what}, {devices} device(s)",
            "ms": 1e3 * seconds,
            "iterations": int(found.stats.iterations.max()), "max_error": float(max(errors)),
            "converged": bool(found.stats.converged.all()),
        })  # fmt: skip
    folder = shared_data()
    path = None if folder is None else folder / "poisson" / "cotton_n5000_w1.npz"
    if path is not None and path.exists():
        data = np.load(path)
        maps = (data["w"], data["d"], data["sx"][:, 1:], data["sy"][1:])
        system = System(*(jnp.asarray(a, jnp.float32) for a in maps))
    else:
        system = generate(512, 1e3)
    solve = jax.jit(diffuse)
    both = jax.jit(jax.value_and_grad(lambda system: jnp.sum(diffuse(system).value ** 2)))
    one, two = (
        repeat(lambda f=f: jax.block_until_ready(f(system)), 2 * repeats)
        for f in (solve, both)
        if jax.block_until_ready(f(system)) is not None
    )
    rows += [
        {"task": "solve of 512x512, 1e-4 of the error", "ms": 1e3 * one},
        {"task": "value and gradient of it", "ms": 1e3 * two, "solves": two / one},
    ]
    keys = ("task", "ms", "solves", "iterations", "max_error", "converged")
    return [{key: row.get(key) for key in keys} for row in rows]


def repeat(function: Callable[[], Any], repeats: int) -> float:
    """Median seconds of a few calls; fewer of slow ones."""
    durations: list[float] = []
    while len(durations) < repeats and sum(durations) < 4:
        start = time.perf_counter()
        function()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations)


def jax_cg(system: System, tolerance: float) -> Answer:
    """`jax.scipy.sparse.linalg.cg` with the diagonal as a preconditioner."""

    def solve(system: System) -> jax.Array:
        inverse = 1 / system.diagonal()
        return jax.scipy.sparse.linalg.cg(
            system.matvec, system.right_hand_side(), tol=tolerance, M=lambda r: inverse * r,
            maxiter=20000,
        )[0]  # fmt: skip

    function = jax.jit(solve)
    value = np.asarray(function(system))
    return Answer(0.0, repeat(lambda: function(system).block_until_ready(), 3), None, value)


def lineax_cg(system: System, tolerance: float) -> Answer:
    """Lineax CG on the tagged operator, with the diagonal as a preconditioner."""
    import lineax as lx

    def solve(system: System) -> tuple[jax.Array, jax.Array]:
        inverse = 1 / system.diagonal()
        tags = lx.positive_semidefinite_tag
        shape = jax.eval_shape(lambda: system.weight)
        preconditioner = lx.FunctionLinearOperator(lambda r: inverse * r, shape, tags)
        solution = lx.linear_solve(
            linear_operator(system), system.right_hand_side(),
            lx.CG(rtol=tolerance, atol=tolerance, max_steps=20000),
            options={"preconditioner": preconditioner}, throw=False,
        )  # fmt: skip
        return solution.value, jnp.asarray(solution.stats["num_steps"])

    function = jax.jit(solve)
    value, steps = jax.block_until_ready(function(system))
    seconds = repeat(lambda: jax.block_until_ready(function(system)), 3)
    return Answer(0.0, seconds, int(steps), np.asarray(value))


def _host(system: System) -> tuple[Any, np.ndarray, float]:
    """The matrix, the right-hand side and the seconds that assembly took (not counted)."""
    right = np.asarray(system.right_hand_side(), np.float64).ravel()
    return scipy.sparse.csr_matrix(system.to_scipy()), right, 0.0


def spsolve(system: System, tolerance: float) -> Answer:
    """SciPy's direct solver (SuperLU)."""
    matrix, right, _ = _host(system)
    matrix = matrix.tocsc()
    start = time.perf_counter()
    value = scipy.sparse.linalg.spsolve(matrix, right)
    return Answer(0.0, time.perf_counter() - start, None, np.asarray(value))


def pyamg_cg(kind: str) -> Callable[[System, float], Answer]:
    """PyAMG as a preconditioner of CG."""

    def run(system: System, tolerance: float) -> Answer:
        pyamg = importlib.import_module("pyamg")
        matrix, right, _ = _host(system)
        matrix.indices = matrix.indices.astype(np.int32)
        matrix.indptr = matrix.indptr.astype(np.int32)
        start = time.perf_counter()
        hierarchy = getattr(pyamg, kind)(matrix)
        middle = time.perf_counter()
        residuals: list[float] = []
        value = hierarchy.solve(right, tol=tolerance, accel="cg", residuals=residuals)
        end = time.perf_counter()
        return Answer(middle - start, end - middle, len(residuals) - 1, value)

    return run


def amgcl(coarsening: str, relaxation: str) -> Callable[[System, float], Answer]:
    """AMGCL through its Python binding, as a preconditioner of CG."""

    def run(system: System, tolerance: float) -> Answer:
        library = importlib.import_module("pyamgcl")
        matrix, right, _ = _host(system)
        start = time.perf_counter()
        parameters = {"coarsening.type": coarsening, "relax.type": relaxation}
        hierarchy = library.amg(matrix, prm=parameters)
        solver = library.solver(hierarchy, {"type": "cg", "tol": tolerance, "maxiter": 1000})
        middle = time.perf_counter()
        value = solver(right)
        end = time.perf_counter()
        return Answer(middle - start, end - middle, int(solver.iters), np.asarray(value))

    return run


def cholmod(system: System, tolerance: float) -> Answer:
    """CHOLMOD through scikit-sparse."""
    library = importlib.import_module("sksparse.cholmod")
    matrix, right, _ = _host(system)
    matrix = matrix.tocsc()
    start = time.perf_counter()
    if hasattr(library, "cho_factor"):
        factor = library.cho_factor(matrix)
    else:
        factor = library.cholesky(matrix)
    middle = time.perf_counter()
    value = factor.solve(right) if hasattr(factor, "solve") else factor(right)
    return Answer(middle - start, time.perf_counter() - middle, None, np.asarray(value))


def solvers(only: str, repeats: int) -> dict[str, Callable[[System, float], Answer]]:
    """All solvers by name."""
    kinds = {"multigrid": Multigrid, "lahbpcg": HierarchicalBasis, "jacobi": Jacobi}
    own = {f"mvedge {name}": ours(kind, repeats) for name, kind in kinds.items()}
    if only == "multigrid":
        return {"mvedge multigrid": own["mvedge multigrid"]}
    if only == "ours":
        return own
    others = {
        "jax cg + jacobi": jax_cg,
        "lineax cg + jacobi": lineax_cg,
        "scipy spsolve": spsolve,
        "pyamg ruge-stueben": pyamg_cg("ruge_stuben_solver"),
        "pyamg smoothed aggregation": pyamg_cg("smoothed_aggregation_solver"),
        "pyamgcl sa + spai0": amgcl("smoothed_aggregation", "spai0"),
        "pyamgcl sa + damped jacobi": amgcl("smoothed_aggregation", "damped_jacobi"),
        "pyamgcl rs + spai0": amgcl("ruge_stuben", "spai0"),
        "pyamgcl sa + gauss-seidel": amgcl("smoothed_aggregation", "gauss_seidel"),
        "cholmod": cholmod,
    }
    return own | others


def measure(
    problem: Problem, name: str, solve: Callable, tolerance: float, exact: np.ndarray | None
) -> dict[str, Any]:
    """One row of the table."""
    row: dict[str, Any] = {
        "system": problem.name, "solver": name, "setup_s": None, "solve_s": None, "total_s": None,
        "iterations": None, "relative_residual": None, "max_error": None, "peak_mb": None,
        "note": "",
    }  # fmt: skip
    try:
        answer = solve(problem.system, tolerance)
    except (ImportError, AttributeError) as error:
        row["note"] = f"not installed: {error}"
        return row
    except (RuntimeError, ValueError) as error:
        row["note"] = f"failed: {error}"[:60]
        return row
    matrix, right, _ = _host(problem.system)
    value = answer.value.astype(np.float64).ravel()
    residual = np.linalg.norm(right - matrix @ value) / np.linalg.norm(right)
    row |= {
        "setup_s": answer.setup, "solve_s": answer.solve, "total_s": answer.setup + answer.solve,
        "iterations": answer.iterations, "relative_residual": float(residual),
        "max_error": None if exact is None else float(np.abs(value - exact.ravel()).max()),
        "peak_mb": peak_memory() / 2**20,
    }  # fmt: skip
    return row


def isolated(arguments: argparse.Namespace, problem: str, solver: str) -> dict[str, Any]:
    """One row from a process of its own, so that peak memory belongs to one solver."""
    command = [
        sys.executable, __file__, "--row", problem, solver, "--tolerance",
        str(arguments.tolerance), "--repeats", str(arguments.repeats),
        "--sizes", *map(str, arguments.sizes), "--contrasts", *map(str, arguments.contrasts),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["killed"])[-1]
        return {"system": problem, "solver": solver, "note": f"crashed: {last}"[:60]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Seconds against pixels on generated systems, log-log; failures are left out."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 5))
    contrasts = sorted({row["system"].split("_c")[1] for row in rows if "discs" in row["system"]})
    if not contrasts:
        return
    names = list(dict.fromkeys(row["solver"] for row in rows))
    for number, solver in enumerate(names):
        points = sorted(
            (int(row["system"].split("_")[1]) ** 2, row["total_s"])
            for row in rows
            if row["solver"] == solver
            and row["system"].endswith(f"_c{contrasts[0]}")
            and row.get("total_s")
            and row["relative_residual"] < 1e-3
        )
        if points:
            width = 3 if solver.startswith("mvedge") else 1.2
            line = {"color": plt.get_cmap("tab20")(number), "linewidth": width, "label": solver}
            axes.loglog(*zip(*points, strict=True), "o-", **line)
    axes.set(xlabel="pixels", ylabel="seconds, setup included", title=f"contrast {contrasts[0]}")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    figure.savefig(path, dpi=150, bbox_inches="tight")


def main() -> None:
    """Runs all solvers on all systems and writes table, JSON, CSV and plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/diffusion"))
    parser.add_argument("--sizes", type=int, nargs="*", default=[128, 256, 512, 1024, 2048])
    parser.add_argument("--contrasts", type=float, nargs="*", default=[1.0, 1e3, 1e6, 1e9])
    parser.add_argument("--tolerance", type=float, default=1e-5, help="relative residual")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--only", choices=["all", "ours", "multigrid", "batches"], default="all")
    parser.add_argument("--devices", type=int, default=1, help="of the CPU, for the batch")
    parser.add_argument("--largest", type=int, default=512, help="largest size for direct solvers")
    parser.add_argument("--no-real", action="store_true", help="generated systems only")
    parser.add_argument("--in-process", action="store_true", help="quick: no memory per solver")
    parser.add_argument("--row", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    if arguments.row:
        wanted, name = arguments.row
        every = problems(arguments.sizes, arguments.contrasts, True)
        problem = next(p for p in every if p.name == wanted)
        row = measure(
            problem, name, solvers("all", arguments.repeats)[name], arguments.tolerance,
            reference(problem, arguments.largest),
        )  # fmt: skip
        print(json.dumps(row))
        return
    if arguments.only == "batches":
        extra = batches_and_gradients(arguments.repeats)
        print_table(extra, title="batches and gradients")
        write_json(arguments.out / "batches.json", extra)
        return
    rows = []
    for problem in problems(arguments.sizes, arguments.contrasts, not arguments.no_real):
        exact = reference(problem, arguments.largest) if arguments.in_process else None
        found = []
        for name, solve in solvers(arguments.only, arguments.repeats).items():
            slow = name in ("scipy spsolve", "cholmod", "jax cg + jacobi", "lineax cg + jacobi")
            if problem.system.shape[0] > arguments.largest and (slow or "jacobi" in name):
                continue
            if arguments.in_process:
                found.append(measure(problem, name, solve, arguments.tolerance, exact))
            else:
                found.append(isolated(arguments, problem.name, name))
        own = next((row.get("total_s") for row in found if row["solver"] == "mvedge multigrid"), 0)
        for row in found:
            total = row.get("total_s")
            row["times_ours"] = total / own if total and own else None
        print_table(found, title=problem.name)
        rows += found
        write_json(arguments.out / "diffusion.json", rows)
    extra = batches_and_gradients(arguments.repeats)
    print_table(extra, title="batches and gradients")
    write_json(arguments.out / "batches.json", extra)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    write_csv(arguments.out / "diffusion.csv", [{k: row.get(k) for k in keys} for row in rows])
    plot(rows, arguments.out / "diffusion.png")


def reference(problem: Problem, largest: int) -> np.ndarray | None:
    """The exact solution: what came with the system, or a direct solve in float64."""
    if problem.exact is not None or problem.system.shape[0] > largest:
        return problem.exact
    matrix, right, _ = _host(problem.system)
    return np.asarray(scipy.sparse.linalg.spsolve(matrix.tocsc(), right))


if __name__ == "__main__":
    main()
