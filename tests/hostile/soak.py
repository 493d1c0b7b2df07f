"""Many calls of one process: `python tests/hostile/soak.py --calls 300`.

Light fields of five shapes take turns, each call with other views, and compiled programs are
forgotten after each round, as `estimate_depth` advises. The first round may compile, which takes
memory of its own; the largest of every later round may exceed that of the second by a tenth.
"""

import argparse
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax import EdgeDepth, LightField, compilation_cache

_SHAPES = ((48, 48), (48, 64), (64, 48), (56, 80), (96, 72))
_ALLOWED = 1.1


def light_field(shape: tuple[int, int], *, key: jax.Array) -> LightField:
    """3x3 views of a plane with texture of its own, at disparity 1."""
    texture = jax.random.uniform(key, (shape[0] + 2, shape[1] + 2, 3))
    rows = [[texture[v : v + shape[0], u : u + shape[1]] for u in range(3)] for v in range(3)]
    views = jnp.stack([jnp.stack(row) for row in rows])
    return LightField(views, disparity_range=(-2.0, 2.0))


def resident() -> float:
    """Resident memory of this process, MiB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def main() -> int:
    """Calls, reads memory, and compares rounds; the exit code is 1 if it grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=6, help="programs are forgotten after each")
    options = parser.parse_args()
    compilation_cache()
    fields = (light_field(shape, key=jax.random.key(0)) for shape in _SHAPES)
    models = [EdgeDepth.for_light_field(field) for field in fields]
    if options.rounds < 3:
        parser.error("--rounds must be at least 3")
    peaks, start = [], time.perf_counter()
    for number, calls in enumerate(np.array_split(np.arange(options.calls), options.rounds)):
        peak = 0.0
        for call in calls:
            which = call % len(_SHAPES)
            field = light_field(_SHAPES[which], key=jax.random.key(call))
            found = models[which](field)
            off = float(jnp.median(jnp.abs(found.disparity - 1)))
            if not off < 0.05:
                sys.stdout.write(f"call {call}: off by {off:.3g} px\n")
                return 1
            peak = max(peak, resident())
        jax.clear_caches()
        peaks.append(peak)
        sys.stdout.write(
            f"round {number}: {len(calls)} calls, at most {peak:.0f} MiB, {resident():.0f} MiB "
            f"after forgetting, {time.perf_counter() - start:.0f} s\n"
        )
        sys.stdout.flush()
    growth = max(peaks[2:]) / peaks[1]
    sys.stdout.write(f"{options.calls} calls: {growth:.3f} times the second round's memory\n")
    return int(growth > _ALLOWED)


if __name__ == "__main__":
    sys.exit(main())
