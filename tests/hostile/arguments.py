"""Arguments that the library should not believe: NaN, swapped, of another kind."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hostile.case import Case, refuses

from mvedge_jax import LightField, Parameters, Sizes, edge_to_depth, multiview_edges
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.edges import EdgeParams, EdgeSizes
from mvedge_jax.edges.sides import BidirectionalParams, SurfaceParams

_WRONG = (TypeError, ValueError)


def cases() -> Iterator[Case]:
    """All of them; none compiles a program."""
    yield from _light_fields()
    yield from _parameters()
    yield from _sizes()
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


def _full() -> Parameters:
    """Parameters with the optional groups, too."""
    return Parameters(bidirectional=BidirectionalParams(), surface=SurfaceParams())


def _parameters() -> Iterator[Case]:
    leaves = jax.tree_util.tree_leaves_with_path(_full())
    names = [jax.tree_util.keystr(path).lstrip(".") for path, _ in leaves]
    for index, name in enumerate(names):
        for value in (np.nan, np.inf, -np.inf, -1.0):

            def run(_: Path, index=index, name=name, value=value) -> None:
                light_field = _light_field()
                sizes = Sizes.for_light_field(light_field)
                for bad in (value, jnp.float32(value)):
                    params = eqx.tree_at(lambda p: jax.tree.leaves(p)[index], _full(), bad)
                    refuses(lambda p=params: edge_to_depth(light_field, p, sizes), f"params.{name}")

            yield Case(f"{name} = {value}", run)
    for field in ("strength_floor", "error_limit"):

        def edges(_: Path, field=field) -> None:
            light_field = _light_field()
            params = EdgeParams(**{field: jnp.float32(np.nan)})
            sizes = EdgeSizes.for_light_field(light_field)
            refuses(lambda: multiview_edges(light_field, params, sizes), f"params.{field}")

        yield Case(f"EdgeParams.{field} = nan", edges)


def _sizes() -> Iterator[Case]:
    choices: list[dict[str, Any]] = [
        {"hypotheses": 0}, {"hypotheses": 1}, {"radius": 0}, {"solves": 0}, {"solves": -1},
        {"window": -1}, {"passes": -1}, {"median_radius": 0}, {"levels": 1}, {"tolerance": 0.0},
        {"tolerance": -1.0}, {"tolerance": float("nan")},
    ]  # fmt: skip
    for choice in choices:

        def run(_: Path, choice=choice) -> None:
            refuses(
                lambda: Sizes.for_light_field(_light_field(), **choice), f"`{next(iter(choice))}`"
            )

        yield Case(f"Sizes with {choice}", run)
    for choice in ({"filters": 2}, {"capacity": 0}, {"spacing": 0.0}, {"spacing": float("nan")}):

        def edges(_: Path, choice=choice) -> None:
            given: dict[str, Any] = {"first": -10, "filters": 21, "capacity": 64} | choice
            refuses(lambda: EdgeSizes(**given), f"`{next(iter(choice))}`")

        yield Case(f"EdgeSizes with {choice}", edges)
    for other in ((-0.5, 0.5), (2.0, 4.0), (-1.0, 0.5)):

        def another_range(_: Path, other=other) -> None:
            sizes = Sizes.for_light_field(LightField(_views(), disparity_range=other))
            refuses(lambda: edge_to_depth(_light_field(), Parameters(), sizes), "`sizes`", "-1")

        yield Case(f"sizes for a range of {other}", another_range)


def _orders() -> Iterator[Case]:
    def arguments() -> dict[str, Any]:
        light_field = _light_field()
        return {
            "light_field": light_field,
            "params": Parameters(),
            "sizes": Sizes.for_light_field(light_field),
        }

    orders = {
        "params, light_field, sizes": ("params", "light_field", "sizes"),
        "light_field, sizes, params": ("light_field", "sizes", "params"),
        "sizes, params, light_field": ("sizes", "params", "light_field"),
    }
    for name, order in orders.items():

        def swapped(_: Path, order=order) -> None:
            given = arguments()
            refuses(lambda: edge_to_depth(*(given[k] for k in order)), "the order is", kinds=_WRONG)

        yield Case(f"edge_to_depth({name})", swapped)
    others: dict[str, Any] = {
        "None": None, "a number": 3.0, "text": "x", "an array": np.zeros((3, 3, 8, 8, 3), "f4"),
        "a dictionary": {}, "a class": Parameters,
    }  # fmt: skip
    for argument in ("light_field", "params", "sizes"):
        for name, value in others.items():

            def other(_: Path, argument=argument, value=value) -> None:
                given = arguments() | {argument: value}
                refuses(lambda: edge_to_depth(**given), f"`{argument}` must be", kinds=_WRONG)

            yield Case(f"edge_to_depth({argument} = {name})", other)


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
    for kind in (Sizes, EdgeSizes):

        def run(_: Path, kind=kind) -> None:
            choose = jax.jit(lambda field: kind.for_light_field(field))
            words = "`light_field.disparity_range` is traced"
            refuses(lambda: choose(_light_field()), words, kinds=_WRONG)

        yield Case(f"{kind.__name__}.for_light_field within jit", run)
