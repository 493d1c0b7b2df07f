"""Arguments that the library should not believe: NaN, swapped, of another kind.

None compiles a program.
"""

import functools
import inspect
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hostile.case import hostile, refuses

from mvedge_jax import EdgeDepth, LightField, describe, multiview_edges
from mvedge_jax.all_views import ViewDepth, depth_of_views
from mvedge_jax.depth import estimate_depth
from mvedge_jax.diffusion import AutoSolver, System, diffuse

_WRONG = (TypeError, ValueError)


def _light_field(ends: tuple[float, float] = (-1.0, 1.0)) -> LightField:
    return LightField(jnp.full((3, 3, 8, 8, 3), 0.5, jnp.float32), disparity_range=ends)


@functools.cache
def _model(preset: Any = "full") -> EdgeDepth:
    return EdgeDepth.for_light_field(_light_field(), preset=preset)


def _number(_: Path, preset: str, name: str, value: float) -> None:
    # Widths of splats are refused as they are set, other numbers as they are used.
    words = f"`{name}`" if ".widths." not in name else name.split(".")[-1]
    for bad in (value, jnp.float32(value)):

        def use(bad=bad) -> Any:
            return estimate_depth(_light_field(), _model(preset).replace({name: bad}))

        refuses(use, words)


for _preset in ("full", "edges", "thesis"):
    _numbers = [row.path for row in describe(_model(_preset)) if not row.static]
    _values = (np.nan, np.inf, -np.inf, -1.0) if _preset == "full" else (np.nan,)
    hostile(
        "preset {}, {} = {}",
        [(_preset, number, value) for number in _numbers for value in _values],
        fast=_preset == "full",
    )(_number)


@hostile("edges with {} = nan", ["edges.strength_floor", "measurement.outlier"])
def _number_of_edges(_: Path, name: str) -> None:
    model = _model().replace({name: jnp.float32(np.nan)})
    refuses(lambda: multiview_edges(_light_field(), model), f"`{name}`")


_CHOICES: list[tuple[str, Any]] = [
    ("calibration.hypotheses", 0), ("calibration.hypotheses", 1), ("measurement.radius", 0),
    ("refine.solves", 0), ("refine.solves", -1), ("calibration.window", -1),
    ("measurement.passes", -1), ("refine.sharpen.radius", 0), ("refine.sharpen.levels", 1),
    ("edges.filters", 2), ("edges.capacity", 0), ("edges.spacing", 0.0),
    ("edges.spacing", float("nan")),
]  # fmt: skip


@hostile("{} = {}", _CHOICES)
def _static_field(_: Path, path: str, value: Any) -> None:
    field, wrong = path.rpartition(".")[2], {path: value}
    refuses(lambda: EdgeDepth.for_light_field(_light_field(), choices=wrong), f"`{field}`")


@hostile("a model for a range of {} .. {}", [(-0.5, 0.5), (2.0, 4.0), (-1.0, 0.5)])
def _another_range(_: Path, low: float, high: float) -> None:
    model = EdgeDepth.for_light_field(_light_field((low, high)))
    refuses(lambda: estimate_depth(_light_field(), model), "`model`", "-1")


@hostile("estimate_depth(model, light_field)")
def _swapped(_: Path) -> None:
    call: Any = estimate_depth
    refuses(lambda: call(_model(), _light_field()), "the order is", kinds=_WRONG)


_OTHERS: dict[str, Any] = {
    "None": None, "a number": 3.0, "text": "x", "an array": np.zeros((3, 3, 8, 8, 3), "f4"),
    "a dictionary": {}, "a class": EdgeDepth,
}  # fmt: skip


@hostile(
    "estimate_depth({} = {})", [(a, name) for a in ("light_field", "model") for name in _OTHERS]
)
def _another_kind(_: Path, argument: str, name: str) -> None:
    given = {"light_field": _light_field(), "model": _model()} | {argument: _OTHERS[name]}
    refuses(lambda: estimate_depth(**given), f"`{argument}` must be", kinds=_WRONG)


@hostile("EdgeDepth.for_light_field({})", ["None", "text", "an array"])
def _no_light_field(_: Path, name: str) -> None:
    # Without the type checks of the tests, which users do not have.
    make = inspect.unwrap(EdgeDepth.for_light_field)
    refuses(lambda: make(_OTHERS[name]), "`light_field` must be LightField", kinds=_WRONG)


@hostile("{.__name__} of views with NaN by tree_at", [estimate_depth, multiview_edges])
def _spoilt_views(_: Path, function: Any) -> None:
    field = _light_field()
    spoilt = eqx.tree_at(lambda f: f.views, field, field.views.at[0, 1, 2, 3].set(jnp.nan))
    place = "view (v, u) = (0, 1) at (x, y) = (3, 2)"
    refuses(lambda: function(spoilt, _model()), place)
    every: Any = depth_of_views
    refuses(lambda: every(spoilt, None, None), place)
    # Closed over by a traced function, they have values, too.
    refuses(lambda: jax.jit(lambda x: function(spoilt, _model()), static_argnums=0)(1), place)


@hostile("{} = 'ColorAndDepth'", ["smoothness", "edges", "sides", "labels", "calibration"])
def _no_part(_: Path, name: str) -> None:
    parts = dict.fromkeys(("calibration", "edges", "sides", "labels", "smoothness"), len)
    given = SimpleNamespace(**parts | {name: "ColorAndDepth"})
    check = inspect.unwrap(EdgeDepth.__check_init__)
    refuses(lambda: check(given), f"`{name}` must be a part", kinds=_WRONG)


@hostile("a smoothness of another shape")
def _another_shape(_: Path) -> None:
    def swapped(guide: Any, disparity: Any, depth_edge: Any) -> Any:
        del guide, depth_edge
        return disparity[1:], disparity[:, 1:]

    model = _model().replace(smoothness=swapped)
    words = "to the right, (8, 7), and downwards, (7, 8); got (7, 8) and (8, 7)"
    refuses(lambda: estimate_depth(_light_field(), model), words)


@hostile("a solver with a tolerance of {}", [-1.0, -1e-6, float("nan")])
def _tolerance(_: Path, value: float) -> None:
    ones = jnp.ones((4, 5))
    system = System(ones, ones, jnp.ones((4, 4)), jnp.ones((3, 5)))
    solver = AutoSolver(tolerance=value)
    refuses(lambda: diffuse(system, solver=solver), "`solver.tolerance`")
    refuses(lambda: diffuse(system, adjoint=solver), "`adjoint.tolerance`")


@hostile("{.__name__}.for_light_field within jit", [EdgeDepth, ViewDepth])
def _traced(_: Path, kind: Any) -> None:
    choose = jax.jit(lambda field: kind.for_light_field(field))
    words = "`light_field.disparity_range` is traced"
    refuses(lambda: choose(_light_field()), words, kinds=_WRONG)
