"""How large the programs are that a first call waits for, stage by stage.

    python experiments/benchmarks/program_size.py --out results/program_size
    python experiments/benchmarks/program_size.py --gradient --size 64

Of every stage, traced and compiled alone: equations of its jaxpr, instructions, fusions and loops
of what XLA makes of it, and seconds of CPU to trace and to compile it. Instructions hardly depend
on the size of the views. "whole" is the program that a call of the model compiles, or, with
`--gradient`, that of a value and its derivative in all numbers and in the views. `--runs` runs
every program once more, under JAX's profiler, and counts what it executes: kernels, those in loops
as often as they run, and conditionals and loops.
"""

import argparse
import gzip
import json
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import print_table, write_csv, write_json

from mvedge_jax import compiler_options
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.depth.solves import Given, Parts, refine_disparity
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import first_labels, gather_evidence, prepare_views
from mvedge_jax.warping import outline

# A name and a kind, such as "fusion"; a tuple may stand between them.
_INSTRUCTION = re.compile(
    r"^\s+(?:ROOT )?%?([\w.\-]+) = (?:\([^=]*?\)|\S+) ([\w\-]+)\(", re.MULTILINE
)
_NO_KERNELS = ("while", "conditional", "call", "tuple", "get-tuple-element", "parameter", "bitcast")
# JAX's profiler writes no more.
_MOST_EVENTS = 1_000_000


def main() -> None:
    """Compiles the stages of one preset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/program_size"))
    parser.add_argument("--preset", choices=["full", "edges"], default="full")
    parser.add_argument("--views", type=int, default=5, help="in a row and in a column")
    parser.add_argument("--size", type=int, default=96, help="side of the views, px")
    parser.add_argument("--gradient", action="store_true", help="value and gradient of every stage")
    parser.add_argument("--only-whole", action="store_true", help="the whole chain alone")
    parser.add_argument("--runs", action="store_true", help="count what a call executes")
    arguments = parser.parse_args()
    shape = (arguments.views, arguments.views, arguments.size, arguments.size)
    scene = synthetic.scene("demo")
    light_field = synthetic.render(scene, shape=shape, key=jax.random.key(0)).bare()
    model = EdgeDepth.for_light_field(light_field, preset=arguments.preset)
    found = [("whole", lambda m, of: m(of), (model, light_field))]
    if not arguments.only_whole:
        found += stages(model, light_field)
    rows = []
    for name, function, of in found:
        counts = _measured(function, of, gradient=arguments.gradient, runs=arguments.runs)
        rows.append({"stage": name, **counts})
        print_table(rows[-1:], title=name)
    kind = "value and gradient" if arguments.gradient else "value"
    print_table(rows, title=f"preset {arguments.preset}, {kind}, {shape}")
    write_json(arguments.out / "program_size.json", {"shape": shape, "kind": kind, "rows": rows})
    write_csv(arguments.out / "program_size.csv", rows)


def stages(model: EdgeDepth, light_field: LightField) -> list[tuple[str, Callable[..., Any], Any]]:
    """The chain's stages with arguments that the chain gives them."""
    measurement = model.measurement
    assert measurement is not None

    @eqx.filter_jit
    def inputs(model: EdgeDepth, light_field: LightField) -> Any:
        evidence = gather_evidence(light_field, model.calibration, measurement, model.searched)
        edges = model.edges(evidence)
        sides = model.sides(edges.points, evidence)
        labels = model.labels(edges.points, sides, evidence, model.refine.precision)
        return evidence, edges.points, sides, labels

    evidence, points, sides, labels = inputs(model, light_field)
    views, seen, measured = evidence.calibrated, evidence.prepared, evidence.measured
    span = jnp.asarray(model.searched[1] - model.searched[0], views.lab.dtype)
    given = Given(labels, seen, views.lab, views.guide, span, sides.edge, views.lit)
    parts = Parts(model.dense, model.smoothness, model.solver, model.refine)
    start = sides.initial if model.dense is None else measured.disparity
    stages = [
        ("calibration", lambda m, of: m.calibration(of, m.searched), (model, light_field)),
        ("prepared views", prepare_views, (views, measurement)),
        ("first labels", first_labels, (views, seen)),
        ("edges", lambda m, of: m.edges(of), (model, evidence)),
        ("sides", lambda m, p, of: m.sides(p, of), (model, points, evidence)),
        (
            "labels of points",
            lambda m, *of: m.labels(*of, m.refine.precision),
            (model, points, sides, evidence),
        ),
        ("map", refine_disparity, (given, start, parts)),
    ]
    if model.refine.outline is not None:
        noise = views.noise.deviation
        stages.append(("outline", outline, (start, views.guide, noise, model.refine.outline)))
    return stages


def _measured(
    function: Callable[..., Any], arguments: Any, *, gradient: bool, runs: bool
) -> dict[str, Any]:
    arrays, rest = eqx.partition(arguments, eqx.is_array)

    def value(arguments: Any) -> list[jax.Array]:
        return jax.tree.leaves(eqx.filter(function(*arguments), eqx.is_array))

    def loss(arguments: Any) -> jax.Array:
        found = (x for x in value(arguments) if jnp.issubdtype(x.dtype, jnp.inexact))
        return sum((jnp.sum(x**2) for x in found), jnp.zeros(()))

    def program(arrays: Any) -> Any:
        whole = eqx.combine(arrays, rest)
        found = eqx.filter_value_and_grad(loss)(whole) if gradient else value(whole)
        return jax.tree.leaves(eqx.filter(found, eqx.is_array))

    # What an earlier stage has traced is traced again, so that stages compare.
    jax.clear_caches()
    start = time.process_time()
    traced = jax.jit(program, compiler_options=compiler_options()).trace(arrays)
    lowered = traced.lower()
    middle = time.process_time()
    program = lowered.compile()
    spent, text = time.process_time() - middle, program.as_text() or ""
    return {
        "equations": sum(1 for _ in _equations(traced.jaxpr.jaxpr)),
        "instructions": len(re.findall(r"^\s+(?:ROOT )?%?[\w.\-]+ = ", text, re.MULTILINE)),
        "fusions": len(re.findall(r" fusion\(", text)),
        "loops": len(re.findall(r" while\(", text)),
        "tracing CPU s": middle - start,
        "compiling CPU s": spent,
        **(_executed(lambda: program(arrays), text) if runs else {}),
    }


def _executed(call: Callable[[], Any], text: str) -> dict[str, int]:
    """How many kernels, loops and conditionals a call runs."""
    kernels, control = executed(call, text)
    return {
        "kernels run": sum(map(len, kernels.values())),
        "loops run": control["while"],
        "conditionals run": control["conditional"],
    }


def executed(call: Callable[[], Any], text: str) -> tuple[dict[str, list[float]], Counter[str]]:
    """What a warm call runs, from the trace of JAX's profiler.

    Args:
        call: runs a compiled program.
        text: of the compiled program.

    Returns:
        Microseconds of every kernel, by the name of its instruction; and how often control flow
        ran, by its kind.
    """
    jax.block_until_ready(call())
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            jax.block_until_ready(call())
        (path,) = Path(folder).rglob("*.trace.json.gz")
        events = json.loads(gzip.decompress(path.read_bytes()))["traceEvents"]
    if len(events) >= _MOST_EVENTS:
        print("The profiler dropped events: counts and times are too low.")
    kinds = dict(_INSTRUCTION.findall(text))
    kernels: dict[str, list[float]] = {}
    control = Counter[str]()
    for event in events:
        kind = kinds.get(event.get("name"))
        if "dur" not in event or kind is None:
            continue
        if kind in _NO_KERNELS:
            control[kind] += 1
        else:
            kernels.setdefault(event["name"], []).append(event["dur"])
    return kernels, control


def _equations(program: Jaxpr) -> Iterator[Any]:
    """All equations, those of inner programs included."""
    for equation in program.eqns:
        yield equation
        for inner in jax.tree.leaves(list(equation.params.values())):
            if isinstance(inner, ClosedJaxpr):
                yield from _equations(inner.jaxpr)
            elif isinstance(inner, Jaxpr):
                yield from _equations(inner)


if __name__ == "__main__":
    main()
