"""Whether results depend on the number of threads: `python tests/hostile/threads.py`.

A rendered scene goes through `EdgeDepth`, value and gradient, in processes that may use one
core or all of them, twice each; the arrays are compared bit by bit. The exit code is 1 if a process
differs from its repetition on as many cores.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

_SCENE = "demo"


def compute(file: Path, size: int) -> None:
    """What a process does: map, error, gradients by leaf, into an archive."""
    import equinox as eqx
    import jax

    from mvedge_jax import EdgeDepth, compilation_cache
    from mvedge_jax.datasets.synthetic import render, scene

    compilation_cache()
    key = jax.random.key(0)
    field = render(scene(_SCENE), shape=(5, 5, size, size), samples=2, key=key).without_truth()
    model = EdgeDepth.for_light_field(field)
    found = model(field)
    gradient = eqx.filter_grad(lambda m: m(field).disparity.mean())(model)
    leaves = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(gradient)])
    arrays: dict[str, Any] = {"views": field.views, "gradient": leaves}
    np.savez(file, disparity=found.disparity, error=found.error, **arrays)


def ran(cores: set[int], size: int) -> dict[str, np.ndarray]:
    """The arrays of a process on some cores: XLA has as many threads as there are at its start."""
    every = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.npz"
        words = [sys.executable, __file__, "--size", str(size), "--into", str(file)]
        os.sched_setaffinity(0, cores)
        try:
            subprocess.run(words, check=True)
        finally:
            os.sched_setaffinity(0, every)
        with np.load(file) as stored:
            return dict(stored)


def apart(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> str:
    """How far two runs are apart, by array."""
    parts = []
    for name in a:
        off = np.abs(a[name].astype(np.float64) - b[name])
        share = np.mean(a[name] != b[name])
        scale = " of the largest" if name == "gradient" else ""
        most = off.max() / (np.abs(a[name]).max() if scale else 1)
        said = "bit-equal" if share == 0 else f"{share:.1%} differ, by at most {most:.2g}{scale}"
        parts.append(f"{name} {said}")
    return "; ".join(parts)


def main() -> int:
    """Runs the four processes and compares them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=96, help="side of the views, px")
    parser.add_argument("--into", type=Path, help="for the script itself")
    options = parser.parse_args()
    if options.into is not None:
        compute(options.into, options.size)
        return 0
    every = os.sched_getaffinity(0)
    kinds = {"1 core": {min(every)}, f"{len(every)} cores": every}
    runs = {name: [ran(cores, options.size) for _ in range(2)] for name, cores in kinds.items()}
    bad = 0
    for name, (first, again) in runs.items():
        said = apart(first, again)
        bad += "differ" in said
        sys.stdout.write(f"{name}, twice: {said}\n")
    few, many = (pair[0] for pair in runs.values())
    sys.stdout.write(f"{' against '.join(runs)}: {apart(few, many)}\n")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
