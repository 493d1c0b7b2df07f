"""Settings per second: batches of a sweep beside single jitted calls, in one process.

    python experiments/benchmarks/sweep.py --out results/benchmark_sweep
    python experiments/benchmarks/sweep.py --memory --scenes demo

Four numbers are varied, on rendered scenes. All ways are compiled and called once before; what is
reported is the sum over the scenes of the warm seconds. A batch computes once what no varied number
reaches: numbers of the diffusion leave the photometry and the edges of a scene alone, numbers of
the photometry leave nothing, hence the two rows. Threads are what `sweep` adds: one call keeps
little more than a core busy. With `--memory`: temporary arrays of one program for 1, 8 and 64
settings by `vmap` and by `batched`, and warm CPU seconds of a setting.
"""

import argparse
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments._report import peak_memory, print_table, write_json
from mvedge_jax import batched, compiler_options, describe
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth, estimate_depth
from mvedge_jax.lightfield import LightField
from mvedge_jax.sweep import evaluate

VARIED = {
    "of the diffusion": (
        "refine.precision",
        "dense.trust",
        "smoothness.color",
        "smoothness.depth",
    ),
    "of the photometry": (
        "calibration.matching.truncation",
        "measurement.drift",
        "measurement.same_color",
        "refine.precision",
    ),
}


def main() -> None:
    """Times all ways."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/benchmark_sweep"))
    parser.add_argument("--scenes", nargs="+", default=["demo", "edges", "slanted"])
    parser.add_argument("--settings", type=int, default=64)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--size", type=int, default=128, help="side of the views, px")
    parser.add_argument("--memory", action="store_true", help="of `vmap` and of `batched`")
    arguments = parser.parse_args()
    if arguments.memory:
        _compare_memory(arguments)
        return
    rows = []
    # Numbers are those of every scene.
    known = _defaults()
    for label, names in VARIED.items():
        generator = np.random.default_rng(0)
        factors = np.exp(generator.uniform(-0.7, 0.7, (arguments.settings, len(names))))
        settings = np.asarray([known[name] for name in names]) * factors
        ways = [(1, 1), (arguments.batch, 1), (1, arguments.threads)]
        ways.append((arguments.batch, arguments.threads))
        seconds, apart = dict.fromkeys(ways, 0.0), 0.0
        for name in arguments.scenes:
            light_field = synthetic.render(
                synthetic.scene(name),
                shape=(9, 9, arguments.size, arguments.size),
                key=jax.random.key(0),
            )
            scores = []
            for batch, threads in ways:
                call = partial(
                    evaluate,
                    light_field,
                    names=names,
                    choices={},
                    preset="full",
                    objective="mae",
                    batch=batch,
                )
                call(settings[:1])
                parts = [settings[i : i + batch] for i in range(0, len(settings), batch)]
                before = time.perf_counter()
                if threads == 1:
                    found = list(map(call, parts))
                else:
                    with ThreadPoolExecutor(threads) as pool:
                        found = list(pool.map(call, parts))
                seconds[batch, threads] += time.perf_counter() - before
                scores.append(np.concatenate(found))
            apart = max(apart, *(float(np.abs(s / scores[0] - 1).max()) for s in scores[1:]))
            jax.clear_caches()
        one = seconds[1, 1]
        for (batch, threads), spent in seconds.items():
            rows.append(
                {
                    "numbers": label,
                    "batch": batch,
                    "threads": threads,
                    "s": spent,
                    "settings per s": arguments.settings * len(arguments.scenes) / spent,
                    "ratio to single calls": one / spent,
                    "largest difference %": 100 * apart,
                    "peak MiB": peak_memory() / 2**20,
                }
            )
    print_table(rows, title=f"{', '.join(arguments.scenes)}, 9x9 views, {arguments.size} px")
    write_json(arguments.out / "sweep.json", rows)


def _defaults() -> dict[str, Any]:
    flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
    return {row.path: row.value for row in describe(EdgeDepth.for_light_field(flat))}


def _compare_memory(arguments: argparse.Namespace) -> None:
    shape = (9, 9, arguments.size, arguments.size)
    scene = synthetic.scene(arguments.scenes[0])
    light_field = synthetic.render(scene, shape=shape, key=jax.random.key(0)).bare()
    arrays, rest = eqx.partition(
        (EdgeDepth.for_light_field(light_field), light_field), eqx.is_array
    )
    rows = []
    for label, names in VARIED.items():

        def one(row: jax.Array, arrays: Any, names: tuple[str, ...] = names) -> jax.Array:
            model, light_field = eqx.combine(arrays, rest)
            varied = model.replace({name: row[i] for i, name in enumerate(names)})
            return estimate_depth(light_field, varied).disparity

        ways = {"vmap": jax.vmap(one, in_axes=(0, None)), "batched": batched(one)}
        factors = np.exp(np.random.default_rng(0).uniform(-0.7, 0.7, (64, len(names))))
        settings = jnp.asarray(factors * [_defaults()[name] for name in names], jnp.float32)
        for count in (1, 8, 64):
            for way, function in ways.items():
                asked, given = compiler_options(), (settings[:count], arrays)
                program = jax.jit(function, compiler_options=asked).lower(*given).compile()
                memory: Any = program.memory_analysis()
                jax.block_until_ready(program(*given))
                start = time.process_time()
                jax.block_until_ready(program(*given))
                spent = time.process_time() - start
                rows.append(
                    {
                        "numbers": label,
                        "settings": count,
                        "way": way,
                        "temporary MiB": memory.temp_size_in_bytes / 2**20,
                        "CPU s a setting": spent / count,
                    }
                )
                print_table(rows[-1:], title=f"{way} of {count}")
                jax.clear_caches()
    print_table(rows, title=f"{arguments.scenes[0]}, 9x9 views, {arguments.size} px")
    write_json(arguments.out / "memory.json", rows)


if __name__ == "__main__":
    main()
