"""Do derivatives of the parameters mean something? Their signs beside those of secants.

A derivative can be right and still mislead where what it belongs to is rugged: per parameter, the
slope of the loss in its logarithm, and the secant through 10 % less and 10 % more.

    python experiments/secants.py --scenes edges demo
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import tyro
from _depth import robust_loss
from _report import print_table, write_json
from _scenes import scenes

from mvedge_jax import lean_jit
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField

Preset = Literal["full", "edges", "thesis"]


@dataclass(frozen=True)
class Arguments:
    """Options.

    Attributes:
        scenes: names of synthetic scenes, or of benchmark scenes under `data`.
        data: folder with `hci/`; None for synthetic scenes only.
        preset: of the chain.
        size: side of rendered views, px.
        reach: of the secants, as a share of the parameter to either side.
        out: folder for the table.
    """

    scenes: tuple[str, ...] = ("edges", "demo")
    data: Path | None = None
    preset: Preset = "full"
    size: int = 128
    reach: float = 0.1
    out: Path = Path("results/secants")


def compared(light_field: LightField, preset: Preset, reach: float) -> list[dict[str, Any]]:
    """A row per parameter of one scene."""
    model = EdgeDepth.for_light_field(light_field.without_truth(), preset=preset)

    def loss(logs: EdgeDepth, light_field: LightField) -> jax.Array:
        found = jax.tree.map(jnp.exp, logs)(light_field.without_truth(), key=jax.random.key(0))
        return robust_loss(found.disparity, light_field)

    logs = jax.tree.map(jnp.log, model)
    # The light field is an argument: the compiler would work a constant out at length.
    gradient = lean_jit(jax.grad(loss))(logs, light_field)
    value = lean_jit(loss)
    leaves, structure = jax.tree_util.tree_flatten_with_path(logs)
    rows = []
    for index, ((path, leaf), slope) in enumerate(
        zip(leaves, jax.tree.leaves(gradient), strict=True)
    ):
        ends = []
        for factor in (1 - reach, 1 + reach):
            moved = [leaf for _, leaf in leaves]
            moved[index] = leaf + jnp.log(jnp.asarray(factor, leaf.dtype))
            ends.append(float(value(structure.unflatten(moved), light_field)))
        secant = (ends[1] - ends[0]) / float(jnp.log((1 + reach) / (1 - reach)))
        rows.append(
            {
                "parameter": jax.tree_util.keystr(path).lstrip("."),
                "derivative": float(slope),
                "secant": secant,
                "same sign": bool(slope * secant > 0) if slope != 0 else None,
            }
        )
    return rows


def main() -> None:
    """Prints a table per scene and the share of parameters whose signs agree."""
    arguments = tyro.cli(Arguments, description=__doc__)
    report = {}
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        rows = compared(light_field, arguments.preset, arguments.reach)
        signs = [row["same sign"] for row in rows if row["same sign"] is not None]
        share = 100 * sum(signs) / len(signs)
        print_table(rows, title=f"{name}: {share:.0f} % of {len(signs)} derivatives agree in sign")
        report[name] = {"agree %": share, "rows": rows}
    write_json(arguments.out / "secants.json", report)


if __name__ == "__main__":
    main()
