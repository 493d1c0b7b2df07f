"""Milliseconds of a warm call by the functions of the package, from JAX's profiler.

    python experiments/benchmarks/by_function.py --scene SCENE --out results/by_function
    python experiments/benchmarks/by_function.py --size 256 --gradient

XLA's instructions keep the stack that traced them, and the profiler times every kernel. Loops count
as often as they run. Kernels run side by side, so that the sum may exceed the call.
"""

import argparse
import re
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import print_table, write_csv, write_json
from program_size import executed

from mvedge_jax import compiler_options
from mvedge_jax.datasets import load_light_field, synthetic
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField

_TABLES = ("FileNames", "FunctionNames", "FileLocations", "StackFrames")


def main() -> None:
    """Compiles, runs and profiles one call."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/by_function"))
    parser.add_argument("--scene", type=Path, help="a light field; default: a rendered one")
    parser.add_argument("--size", type=int, default=512, help="side of the rendered views, px")
    parser.add_argument("--preset", choices=["full", "edges", "learned"], default="full")
    parser.add_argument("--gradient", action="store_true", help="value and gradient in the model")
    parser.add_argument("--most", type=int, default=40, help="rows of the table")
    arguments = parser.parse_args()
    if arguments.scene is None:
        shape = (9, 9, arguments.size, arguments.size)
        scene = synthetic.scene("demo")
        light_field = synthetic.render(scene, shape=shape, samples=2, key=jax.random.key(0))
    else:
        light_field = load_light_field(arguments.scene)
    light_field = light_field.bare()
    model = EdgeDepth.for_light_field(light_field, preset=arguments.preset)

    def value(model: EdgeDepth, light_field: LightField) -> jax.Array:
        return jnp.mean(model(light_field).disparity)

    function = jax.value_and_grad(value) if arguments.gradient else value
    jitted = jax.jit(function, compiler_options=compiler_options())
    program = jitted.lower(model, light_field).compile()
    text = program.as_text() or ""
    places, by_place = functions(text), defaultdict[str, list[float]](list)
    kernels, _ = executed(lambda: program(model, light_field), text)
    for name, times in kernels.items():
        by_place[places.get(name, "?")] += times
    total = sum(map(sum, by_place.values()))
    order = sorted(by_place.items(), key=lambda item: -sum(item[1]))
    rows = [
        {"function": place, "ms": sum(t) / 1e3, "share": sum(t) / total, "kernels run": len(t)}
        for place, t in order[: arguments.most]
    ]
    print_table(rows, title=f"{total / 1e3:.0f} ms in {sum(map(len, by_place.values()))} kernels")
    write_json(arguments.out / "by_function.json", rows)
    write_csv(arguments.out / "by_function.csv", rows)


def functions(text: str) -> dict[str, str]:
    """For each instruction of a compiled program, the innermost function of the package."""
    tables: dict[str, dict[int, Any]] = {name: {} for name in _TABLES}
    table, frame_of = None, {}
    for line in text.splitlines():
        if line in tables:
            table = tables[line]
        elif table is not None and (entry := re.match(r"(\d+) (.*)", line)):
            fields = dict(re.findall(r"(\w+)=(\d+)", entry[2]))
            table[int(entry[1])] = {k: int(v) for k, v in fields.items()} or entry[2].strip('"')
        elif found := re.match(r"\s+(?:ROOT )?%?([\w.\-]+) = .*stack_frame_id=(\d+)", line):
            frame_of[found[1]] = int(found[2])
    files, names, locations, frames = (tables[name] for name in _TABLES)

    def place(frame: int) -> str:
        while frame in frames:
            at = locations[frames[frame]["file_location_id"]]
            file = files[at["file_name_id"]].partition("/mvedge_jax/")[2]
            if file:
                return f"{file}:{at['line']} {names[at['function_name_id']]}"
            parent = frames[frame].get("parent_frame_id", frame)
            frame = parent if parent != frame else -1
        return "?"

    known = {frame: place(frame) for frame in set(frame_of.values())}
    return {name: known[frame] for name, frame in frame_of.items()}


if __name__ == "__main__":
    main()
