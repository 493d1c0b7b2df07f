"""Do derivatives of the parameters mean something? Their signs beside those of secants.

A derivative can be right and still mislead where what it belongs to is rugged: per parameter, the
slope of the loss in its logarithm, and the secant through 10 % less and 10 % more. Taps of the
filter bank are moved along random directions, every tap by a random share of itself, whose standard
deviation is 2 % at either end. Parameters whose derivative is 0 are thresholds, and left out.

    python experiments/secants.py --preset edges
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import tyro
from _learning import of_one_range
from _report import print_table, write_json

from mvedge_jax import lean_jit
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edges import OrientedEdges
from mvedge_jax.epi import FilterBank
from mvedge_jax.learn import robust_loss
from mvedge_jax.lightfield import LightField

# What moves: logarithms of the parameters, and shares by which taps are larger.
Moved = tuple[EdgeDepth, list[jax.Array]]


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scenes: names of synthetic scenes.
        preset: of the chain.
        sharpened: whether depth steps are moved onto color steps.
        size: side of the views, px.
        reach: of the secants, as a share of the parameter to either side.
        directions: of the taps.
        reach_of_taps: of their secants, as a share of every tap to either side.
        scale: errors well above it count little more than those near it, px.
        matters: a derivative that is smaller than this share of the loss is counted apart.
        out: folder for the table.
    """

    scenes: tuple[str, ...] = ("edges", "demo", "thin", "wide")
    preset: Literal["full", "edges"] = "full"
    sharpened: bool = True
    size: int = 96
    reach: float = 0.1
    directions: int = 10
    reach_of_taps: float = 0.02
    scale: float = 0.03
    matters: float = 1e-3
    out: Path = Path("results/secants")


def main() -> None:
    """Prints a table per scene and the share of parameters whose signs agree."""
    arguments = tyro.cli(Arguments, description=__doc__)
    fields = of_one_range(arguments.scenes, size=arguments.size)
    choices = {} if arguments.sharpened else {"refine.sharpen.mode": "none"}
    start, model_of = _start(next(iter(fields.values())), arguments.preset, choices)

    def loss(moved: Moved, light_field: LightField) -> jax.Array:
        found = model_of(moved)(light_field.without_truth())
        return robust_loss(found.disparity, light_field, scales=(arguments.scale,))

    # The light field is an argument: the compiler would work a constant out at length.
    gradient, value = lean_jit(jax.grad(loss)), lean_jit(loss)
    report = {}
    for name, field in fields.items():
        slopes, center = gradient(start, field), float(value(start, field))
        rows = []
        for path, direction, reach in _directions(start, slopes, arguments):
            slope = _dot(slopes, direction)
            low, high = (float(value(_plus(start, direction, t), field)) for t in (-reach, reach))
            secant = (high - low) / (2 * reach)
            rows.append(
                {
                    "parameter": path,
                    "derivative": slope,
                    "secant": secant,
                    "same sign": slope * secant > 0,
                    "matters": max(abs(slope), abs(secant)) > arguments.matters * center,
                }
            )
        report[name] = {"loss": center, **_shares(rows), "rows": rows}
        print_table(rows, title=f"{name}, loss {center:.4f}: {_shares(rows)}")
        kind = arguments.preset + ("" if arguments.sharpened else "_unsharpened")
        write_json(arguments.out / f"secants_{kind}.json", report)


def _start(
    light_field: LightField, preset: Literal["full", "edges"], choices: dict[str, str]
) -> tuple[Moved, Any]:
    """What moves, where it starts, and the model that it makes."""
    model = EdgeDepth.for_light_field(light_field, preset=preset, choices=choices)
    assert isinstance(model.edges, OrientedEdges)
    banks = model.edges.prewitt(light_field.views.shape)

    def model_of(moved: Moved) -> EdgeDepth:
        logs, shares = moved
        pairs = zip(banks, shares, strict=True)
        across, down = (FilterBank(b.disparity, b.taps * (1 + s)) for b, s in pairs)
        return jax.tree.map(jnp.exp, logs).replace({"edges.banks": (across, down)})

    shares = [jnp.zeros_like(bank.taps) for bank in banks]
    return (jax.tree.map(jnp.log, model), shares), model_of


def _directions(
    start: Moved, slopes: Moved, arguments: Arguments
) -> Iterator[tuple[str, Moved, float]]:
    """Names, directions and reaches: of every parameter that has a derivative, and of the taps."""
    still = jax.tree.map(jnp.zeros_like, start)
    leaves, structure = jax.tree_util.tree_flatten_with_path(start[0])
    for index, ((path, _), slope) in enumerate(
        zip(leaves, jax.tree.leaves(slopes[0]), strict=True)
    ):
        if float(slope) != 0:
            units = [jnp.asarray(i == index, leaf.dtype) for i, (_, leaf) in enumerate(leaves)]
            name = jax.tree_util.keystr(path).lstrip(".")
            yield name, (structure.unflatten(units), still[1]), arguments.reach
    for k in range(arguments.directions):
        keys = jax.random.split(jax.random.key(k), 2)
        taps = [
            jax.random.normal(*pair) for pair in zip(keys, [s.shape for s in still[1]], strict=True)
        ]
        yield f"taps, direction {k}", (still[0], taps), arguments.reach_of_taps


def _plus(start: Moved, direction: Moved, step: float) -> Moved:
    return jax.tree.map(lambda a, b: a + step * b, start, direction)


def _dot(one: Moved, other: Moved) -> float:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return sum(float(jnp.vdot(a, b)) for a, b in pairs)


def _shares(rows: list[dict[str, Any]]) -> dict[str, str]:
    """How many signs agree: of the parameters, of those that matter, and of the taps."""
    taps = [row for row in rows if row["parameter"].startswith("taps")]
    numbers = [row for row in rows if row not in taps]
    groups = {
        "parameters": numbers,
        "those that matter": [row for row in numbers if row["matters"]],
        "taps": taps,
    }
    return {
        name: f"{sum(row['same sign'] for row in group)} of {len(group)}"
        for name, group in groups.items()
    }


if __name__ == "__main__":
    main()
