"""Arguments that the library should not believe: NaN, swapped, of another kind."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from hostile.case import Case, refuses

from mvedge_jax import EdgeDepth, LightField, describe, multiview_edges
from mvedge_jax.all_views import ViewDepth
from mvedge_jax.depth import estimate_depth
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.edges import OrientedEdges

_WRONG = (TypeError, ValueError)


def cases() -> Iterator[Case]:
    """All of them; none compiles a program."""
    yield from _light_fields()
    yield from _numbers()
    yield from _static_fields()
    yield from _paths()
    yield from _orders()
    yield from _tolerances()
    yield from _traced()


def _views(dtype: Any = jnp.float32) -> jax.Array:
    return jnp.full((3, 3, 8, 8, 3), 0.5, dtype)


def _light_field() -> LightField:
    return LightField(_views(), disparity_range=(-1.0, 1.0))


def _light_fields() -> Iterator[Case]:
    views = np.full((3, 3, 8, 8, 3), 0.5, "f4")

    def spoilt(value: float) -> np.ndarray:
        changed = views.copy()
        changed[1, 2, 3, 4, 0] = value
        return changed

    wrong: dict[str, dict[str, Any]] = {
        "uint8": {"views": np.zeros((3, 3, 8, 8, 3), np.uint8)},
        "float16": {"views": views.astype("f2")},
        "bfloat16": {"views": jnp.asarray(views, jnp.bfloat16)},
        "complex": {"views": views.astype("c8")},
        "4 axes": {"views": views[0]},
        "6 axes": {"views": views[None]},
        "grey": {"views": views[..., :1]},
        "alpha": {"views": np.concatenate([views, views[..., :1]], -1)},
        "an even grid": {"views": views[:2]},
        "no pixels": {"views": views[:, :, :0]},
        "0..255": {"views": 255 * views},
        "NaN": {"views": spoilt(np.nan)},
        "infinity": {"views": spoilt(np.inf)},
        "negative": {"views": spoilt(-0.5)},
        "available of another shape": {"views": views, "available": np.ones((5, 5), bool)},
        "no crosshair": {"views": views, "available": np.eye(3, dtype=bool)},
        "nothing available": {"views": views, "available": np.zeros((3, 3), bool)},
        "an empty range": {"views": views, "disparity_range": (1.0, 1.0)},
        "a reversed range": {"views": views, "disparity_range": (1.0, -1.0)},
        "a range of NaN": {"views": views, "disparity_range": (np.nan, 1.0)},
        "an endless range": {"views": views, "disparity_range": (-np.inf, 1.0)},
        "a range of three": {"views": views, "disparity_range": (0.0, 1.0, 2.0)},
    }
    for name, given in wrong.items():

        def run(_: Path, given=given) -> None:
            refuses(lambda: LightField(**given), "`", kinds=_WRONG)

        yield Case(f"a light field of {name}", run)


def _model(preset: Any = "full") -> EdgeDepth:
    return EdgeDepth.for_light_field(_light_field(), preset=preset)


def _numbers() -> Iterator[Case]:
    for preset in ("full", "edges", "thesis"):
        names = [row.path for row in describe(_model(preset)) if not row.static]
        for name in names:
            for value in (np.nan, np.inf, -np.inf, -1.0) if preset == "full" else (np.nan,):

                def run(_: Path, preset=preset, name=name, value=value) -> None:
                    # Widths of splats are refused as they are set, other numbers as they are used.
                    words = f"`{name}`" if ".widths." not in name else name.split(".")[-1]
                    for bad in (value, jnp.float32(value)):

                        def use(bad=bad) -> Any:
                            model = _model(preset).replace({name: bad})
                            return estimate_depth(_light_field(), model)

                        refuses(use, words)

                yield Case(f"{name} = {value} in preset {preset}", run, fast=preset == "full")
    for name in ("edges.strength_floor", "measurement.outlier"):

        def edges(_: Path, name=name) -> None:
            model = _model().replace({name: jnp.float32(np.nan)})
            refuses(lambda: multiview_edges(_light_field(), model), f"`{name}`")

        yield Case(f"edges with {name} = nan", edges)


def _static_fields() -> Iterator[Case]:
    choices: list[tuple[str, Any]] = [
        ("calibration.hypotheses", 0), ("calibration.hypotheses", 1), ("measurement.radius", 0),
        ("refine.solves", 0), ("refine.solves", -1), ("calibration.window", -1),
        ("measurement.passes", -1), ("refine.sharpen.radius", 0), ("refine.sharpen.levels", 1),
        ("edges.filters", 2), ("edges.capacity", 0), ("edges.spacing", 0.0),
        ("edges.spacing", float("nan")),
    ]  # fmt: skip
    for path, value in choices:

        def run(_: Path, path=path, value=value) -> None:
            field, wrong = path.rpartition(".")[2], {path: value}
            refuses(lambda: EdgeDepth.for_light_field(_light_field(), choices=wrong), f"`{field}`")

        yield Case(f"{path} = {value}", run)
    for choice in ({"filters": 2}, {"capacity": 0}, {"spacing": 0.0}, {"spacing": float("nan")}):

        def edges(_: Path, choice=choice) -> None:
            given: dict[str, Any] = {"first": -10, "filters": 21, "capacity": 64} | choice
            refuses(lambda: OrientedEdges(**given), f"`{next(iter(choice))}`")

        yield Case(f"OrientedEdges with {choice}", edges)
    for other in ((-0.5, 0.5), (2.0, 4.0), (-1.0, 0.5)):

        def another_range(_: Path, other=other) -> None:
            narrow = LightField(_views(), disparity_range=other)
            model = EdgeDepth.for_light_field(narrow)
            refuses(lambda: estimate_depth(_light_field(), model), "`model`", "-1")

        yield Case(f"a model for a range of {other}", another_range)


def _paths() -> Iterator[Case]:
    for path in ("", ".", "smoothness.colour", "smoothness.color.", "a.b", "dense.trust.x"):

        def run(_: Path, path=path) -> None:
            wrong = {path: 1.0}
            refuses(lambda: _model().replace(wrong), f"`{path}` is no path of `EdgeDepth`")

        yield Case(f"a model's {path!r}", run)


def _orders() -> Iterator[Case]:
    def swapped(_: Path) -> None:
        call: Any = estimate_depth
        refuses(lambda: call(_model(), _light_field()), "the order is", kinds=_WRONG)

    yield Case("estimate_depth(model, light_field)", swapped)
    others: dict[str, Any] = {
        "None": None, "a number": 3.0, "text": "x", "an array": np.zeros((3, 3, 8, 8, 3), "f4"),
        "a dictionary": {}, "a class": EdgeDepth,
    }  # fmt: skip
    for argument in ("light_field", "model"):
        for name, value in others.items():

            def other(_: Path, argument=argument, value=value) -> None:
                given = {"light_field": _light_field(), "model": _model()} | {argument: value}
                refuses(lambda: estimate_depth(**given), f"`{argument}` must be", kinds=_WRONG)

            yield Case(f"estimate_depth({argument} = {name})", other)


def _tolerances() -> Iterator[Case]:
    for value in (-1.0, -1e-6, float("nan")):

        def run(_: Path, value=value) -> None:
            ones = jnp.ones((4, 5))
            system = System(ones, ones, jnp.ones((4, 4)), jnp.ones((3, 5)))
            solver = AutoSolver(tolerance=value)
            refuses(lambda: diffuse(system, solver=solver), "`solver.tolerance`")
            refuses(lambda: diffuse(system, adjoint=solver), "`adjoint.tolerance`")

        yield Case(f"a solver with a tolerance of {value}", run)


def _traced() -> Iterator[Case]:
    for kind in (EdgeDepth, ViewDepth):

        def run(_: Path, kind=kind) -> None:
            choose = jax.jit(lambda field: kind.for_light_field(field))
            words = "`light_field.disparity_range` is traced"
            refuses(lambda: choose(_light_field()), words, kinds=_WRONG)

        yield Case(f"{kind.__name__}.for_light_field within jit", run)
