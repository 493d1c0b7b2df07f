"""Settings per second: batches of a sweep beside single jitted calls, in one process.

    python experiments/benchmarks/sweep.py --out results/benchmark_sweep

Four numbers are varied, on rendered scenes. Both ways are compiled and called once before; what is
reported is the sum over the scenes of the warm seconds. A batch computes once what no varied number
reaches: numbers of the diffusion leave the photometry and the edges of a scene alone, numbers of
the photometry leave nothing, hence the two rows.
"""

import argparse
import sys
import time
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments._report import peak_memory, print_table, write_json
from mvedge_jax.centre import Parameters
from mvedge_jax.datasets import synthetic
from mvedge_jax.sweep import Interval, Space, evaluate

VARIED = {
    "of the diffusion": (
        "centre.precision",
        "centre.trust",
        "smoothness.colour",
        "smoothness.depth",
    ),
    "of the photometry": (
        "volume.truncation",
        "photometric.drift",
        "photometric.same_colour",
        "centre.precision",
    ),
}


def main() -> None:
    """Times both ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/benchmark_sweep"))
    parser.add_argument("--scenes", nargs="+", default=["demo", "edges", "slanted"])
    parser.add_argument("--settings", type=int, default=64)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--size", type=int, default=128, help="side of the views, px")
    arguments = parser.parse_args()
    start, rows = Parameters(), []
    for label, names in VARIED.items():
        first = Space({name: Interval(1e-6, 1e6) for name in names}).start(start)
        assert first is not None
        generator = np.random.default_rng(0)
        factors = np.exp(generator.uniform(-0.7, 0.7, (arguments.settings, len(names))))
        settings = np.asarray([first[name] for name in names]) * factors
        seconds, apart = {1: 0.0, arguments.batch: 0.0}, 0.0
        for name in arguments.scenes:
            light_field = synthetic.render(
                synthetic.scene(name),
                shape=(9, 9, arguments.size, arguments.size),
                key=jax.random.key(0),
            )
            scores = []
            for batch in seconds:
                options = {"names": names, "choices": {}, "objective": "mae", "batch": batch}
                evaluate(light_field, settings[:1], start, **options)
                before = time.perf_counter()
                scores.append(evaluate(light_field, settings, start, **options))
                seconds[batch] += time.perf_counter() - before
            apart = max(apart, float(np.abs(scores[1] / scores[0] - 1).max()))
            jax.clear_caches()
        one, many = seconds.values()
        rows.append(
            {
                "numbers": label,
                "settings": arguments.settings * len(arguments.scenes),
                "single calls s": one,
                f"batches of {arguments.batch} s": many,
                "ratio": one / many,
                "largest difference %": 100 * apart,
                "peak MiB": peak_memory() / 2**20,
            }
        )
    print_table(rows, title=f"{', '.join(arguments.scenes)}, 9x9 views, {arguments.size} px")
    write_json(arguments.out / "sweep.json", rows)


if __name__ == "__main__":
    main()
