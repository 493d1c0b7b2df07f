"""What every trick of `mvedge_jax._cpu` is worth: with it and without, in one process.

    python experiments/benchmarks/cpu_tricks.py --out results/cpu_tricks
    python experiments/benchmarks/cpu_tricks.py --whole --only "fences" "plane sums"
    python experiments/benchmarks/cpu_tricks.py --gradient --size 64 --only "stages" "unstack"

Stages of the chain are compiled alone, or, with `--whole`, the chain. Of every trick: seconds of
CPU to trace and compile, MiB of temporary arrays, seconds of CPU of a warm call. Ratios are those
of "without" over "with", so that what is above 1 is gained. Warm calls of both programs alternate;
the median of their ratios is printed.
"""

import argparse
import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from program_size import stages

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import print_table, write_json

from mvedge_jax import _cpu, compiler_options
from mvedge_jax._checkpoint import checkpoint
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth

Off = Callable[[], contextlib.AbstractContextManager[Any]]


def main() -> None:
    """Compares programs with and without each trick."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/cpu_tricks"))
    parser.add_argument("--preset", choices=["full", "edges", "learned"], default="full")
    parser.add_argument("--views", type=int, default=5, help="in a row and in a column")
    parser.add_argument("--size", type=int, default=256, help="side of the views, px")
    parser.add_argument("--runs", type=int, default=5, help="warm calls of each program")
    parser.add_argument("--gradient", action="store_true", help="value and gradient")
    parser.add_argument("--whole", action="store_true", help="the chain, not its stages")
    parser.add_argument("--stages", nargs="+", help="some of program_size.py's, by name")
    parser.add_argument("--only", nargs="+", choices=list(_TRICKS), help="some tricks")
    arguments = parser.parse_args()
    shape = (arguments.views, arguments.views, arguments.size, arguments.size)
    scene = synthetic.scene("demo")
    light_field = synthetic.render(scene, shape=shape, key=jax.random.key(0)).bare()
    model = EdgeDepth.for_light_field(light_field, preset=arguments.preset)
    if arguments.whole:
        programs = [("whole", lambda m, of: m(of), (model, light_field))]
    else:
        programs = stages(model, light_field)
    if arguments.stages:
        programs = [program for program in programs if program[0] in arguments.stages]
    rows = []
    for stage, function, of in programs:
        program = _program(function, arguments.gradient)
        for name in arguments.only or _TRICKS:
            usual = _Compiled(program, of)
            with _TRICKS[name]():
                other = _Compiled(program, of)
            rows.append({"stage": stage, "without": name, **_beside(usual, other, arguments.runs)})
            print_table(rows[-1:], title=f"{stage}, without {name}")
    kind = "value and gradient" if arguments.gradient else "value"
    print_table(rows, title=f"{kind}, {shape}")
    write_json(arguments.out / "cpu_tricks.json", {"shape": shape, "kind": kind, "rows": rows})


@contextlib.contextmanager
def _replaced(name: str, other: Any, *modules: str) -> Iterator[None]:
    """Another function in place of one of `_cpu`, in all modules of the package or in some."""
    usual = getattr(_cpu, name)
    with contextlib.ExitStack() as stack:
        for path, module in list(sys.modules.items()):
            ours = path.startswith("mvedge_jax.") and getattr(module, name, None) is usual
            if ours and (not modules or path.endswith(modules)):
                stack.enter_context(mock.patch.object(module, name, other))
        yield


def _without_option(name: str) -> Off:
    def off() -> contextlib.AbstractContextManager[Any]:
        kept = {k: v for k, v in _cpu.compiler_options().items() if not k.endswith(name)}
        return mock.patch.object(sys.modules[__name__], "compiler_options", return_value=kept)

    return off


def _plain(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


def _each(function: Callable[..., Any], first: Any, second: Any) -> tuple[Any, Any]:
    return _cpu.no_fuse(function, first), _cpu.no_fuse(function, second)


_TRICKS: dict[str, Off] = {
    "fences": lambda: _replaced("no_fuse", _plain),
    **{
        f"fences of {place}": lambda place=place: _replaced("no_fuse", _plain, place)
        for place in ("_coarsen", "_multigrid", "_median", "_arm", "_window", "_crosshair")
    },
    "stages": lambda: _replaced("checkpoint_stage", checkpoint),
    "loops over both arms": lambda: _replaced("of_both", _each),
    "plane sums": lambda: _replaced("plane_sum", lambda planes: jnp.sum(planes, axis=0)),
    "convolutions": lambda: _replaced("convolution", lambda layer, planes: layer(planes)),
    "unstack": lambda: _replaced("unstack", list),
    "collections": lambda: _replaced("no_collections", contextlib.nullcontext),
    "emitters": _without_option("fusion_emitters"),
    "order of kernels": _without_option("scheduler_type"),
    "level": _without_option("optimization_level"),
}


def _program(function: Callable[..., Any], gradient: bool) -> Callable[..., Any]:
    def value(arguments: Any) -> list[jax.Array]:
        return jax.tree.leaves(eqx.filter(function(*arguments), eqx.is_array))

    def loss(arguments: Any) -> jax.Array:
        found = (x for x in value(arguments) if jnp.issubdtype(x.dtype, jnp.inexact))
        return sum((jnp.sum(x**2) for x in found), jnp.zeros(()))

    return eqx.filter_value_and_grad(loss) if gradient else value


class _Compiled:
    """A program and what it took to compile it."""

    def __init__(self, program: Callable[..., Any], arguments: Any):
        self.arrays, rest = eqx.partition(arguments, eqx.is_array)

        def of_arrays(arrays: Any) -> Any:
            return jax.tree.leaves(eqx.filter(program(eqx.combine(arrays, rest)), eqx.is_array))

        jax.clear_caches()
        start = time.process_time()
        with sys.modules["mvedge_jax._compiler"].no_collections():
            lowered = jax.jit(of_arrays, compiler_options=compiler_options()).lower(self.arrays)
        middle = time.process_time()
        self.run = lowered.compile()
        self.tracing, self.compiling = middle - start, time.process_time() - middle
        memory = self.run.memory_analysis()
        self.temporary = memory.temp_size_in_bytes / 2**20 if memory else float("nan")

    def seconds(self) -> float:
        """CPU seconds of a call."""
        start = time.process_time()
        jax.block_until_ready(self.run(self.arrays))
        return time.process_time() - start


def _beside(usual: _Compiled, other: _Compiled, runs: int) -> dict[str, float]:
    for compiled in (usual, other):
        compiled.seconds()
    pairs = np.asarray([(usual.seconds(), other.seconds()) for _ in range(runs)])
    return {
        "tracing": other.tracing / usual.tracing,
        "compiling": other.compiling / usual.compiling,
        "temporary": other.temporary / max(usual.temporary, 1e-9),
        "warm": float(np.median(pairs[:, 1] / pairs[:, 0])),
        "compiling CPU s": usual.compiling,
        "temporary MiB": usual.temporary,
        "warm CPU s": float(np.median(pairs[:, 0])),
    }


if __name__ == "__main__":
    main()
