"""Figures B.1, B.3, B.4, B.5 and B.7: the thesis' map under noise in labels, blur and darkness.

    python experiments/figures_b.py --scenes cotton edges --out results/figures_b

Preset `thesis` with its sides by bidirectional diffusion (`thesis`), with sides by the reprojection
error (`reprojection`, B.7), and with labels that stay on their edges, at the weights and smoothness
of the first (`naive`, B.1); and preset `full`. B.3: Gaussian noise in the disparity of every edge
point; `full` also has labels that are no edge points, which stay. B.4: all views are blurred. B.5:
all views are darkened and stored with 8 bits, so that texture is left in a few gray levels. Curves
are MSE x 100 and Q25 x 100 of the center view's map, full frame; pictures have the maps and errors
without disturbance.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from _report import print_table, shared_data, write_csv, write_json
from _scenes import scenes
from jaxtyping import Array, Float, PRNGKeyArray
from matplotlib.figure import Figure

from mvedge_jax import lean_jit
from mvedge_jax._params import number
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.edges import Edges
from mvedge_jax.edges.sides import ReprojectionSides
from mvedge_jax.image import gaussian
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry import Evidence
from mvedge_jax.plotting import plot_comparison

# Pixels that occluders are looked for in.
_RADIUS = 8
# Where the widest blur is cut, px.
_REACH = 9


class NoisyEdges(eqx.Module):
    """Edge points whose disparities are disturbed.

    Attributes:
        edges: finds the points.
        noise: standard deviation, px per view step.
    """

    edges: Any
    noise: Float[Array, ""] = number(0.0, "px")

    def __call__(self, evidence: Evidence, *, key: PRNGKeyArray | None = None) -> Edges:
        """See `EdgeDetector`."""
        found = self.edges(evidence, key=key)
        own = found.points.disparity
        noise = self.noise * jax.random.normal(jax.random.key(7), own.shape, own.dtype)
        noisy = jnp.where(found.points.valid, own + noise, own)
        return eqx.tree_at(lambda edges: edges.points.disparity, found, noisy)


def _thesis(light_field: LightField, **changes: Any) -> EdgeDepth:
    model = EdgeDepth.for_light_field(light_field, preset="thesis")
    return model.replace(changes) if changes else model


METHODS: dict[str, Callable[[LightField], EdgeDepth]] = {
    "thesis": _thesis,
    "reprojection": lambda field: _thesis(field, sides=ReprojectionSides(radius=_RADIUS)),
    "naive": lambda field: _thesis(field, **{"sides.vote.offset": jnp.asarray(0.0)}),
    "full": EdgeDepth.for_light_field,
}


def blurred(light_field: LightField, sigma: float) -> LightField:
    """All views blurred by a Gaussian of a standard deviation in px."""
    planes = jnp.moveaxis(light_field.views, -1, -3)
    soft = gaussian(planes, jnp.asarray(sigma, planes.dtype), _REACH)
    return eqx.tree_at(lambda field: field.views, light_field, jnp.moveaxis(soft, -3, -1))


def darkened(light_field: LightField, factor: float) -> LightField:
    """All views multiplied by a factor and rounded to 8 bits."""
    dark = jnp.round(255 * factor * light_field.views) / 255
    return eqx.tree_at(lambda field: field.views, light_field, dark)


# Of each figure: what is disturbed, and how much.
LEVELS = {
    "B.3": ("noise in labels, px", (0.0, 0.02, 0.05, 0.1, 0.2, 0.4)),
    "B.4": ("blur of the views, px", (0.0, 0.5, 1.0, 2.0, 3.0)),
    "B.5": ("brightness of the views", (1.0, 0.3, 0.1, 0.03)),
}


def disturbed(
    figure: str, level: float, model: EdgeDepth, light_field: LightField
) -> tuple[EdgeDepth, LightField]:
    """The model and the views of one point of a curve."""
    if figure == "B.3":
        return model.replace({"edges.noise": jnp.asarray(level)}), light_field
    change = blurred if figure == "B.4" else darkened
    return model, change(light_field, level) if level != LEVELS[figure][1][0] else light_field


@lean_jit
def _run(model: EdgeDepth, light_field: LightField) -> jax.Array:
    return model(light_field, key=jax.random.key(0)).disparity


def curves(
    name: str, light_field: LightField, method: str, figures: Sequence[str]
) -> tuple[list[dict[str, Any]], jax.Array]:
    """A row per figure and level, and the map without disturbance."""
    truth, blind = light_field.truth, light_field.without_truth()
    assert truth is not None
    model = METHODS[method](blind)
    model = model.replace(edges=NoisyEdges(model.edges))
    rows = []
    for figure in figures:
        for level in LEVELS[figure][1]:
            found = _run(*disturbed(figure, level, model, blind))
            scores = depth_scores(found, truth.disparity, mask=truth.valid)
            row = {"scene": name, "figure": figure, "method": method, "level": level}
            rows.append({**row, "MSE*100": float(scores.mse), "Q25*100": float(scores.q25)})
    return rows, _run(model, blind)


def main() -> None:
    """Draws the curves and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("results/figures_b"))
    parser.add_argument("--data", type=Path, default=shared_data())
    parser.add_argument("--scenes", nargs="+", default=["edges", "demo"])
    parser.add_argument("--size", type=int, default=256, help="side of the rendered scenes, px")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--only", nargs="+", choices=list(LEVELS), default=list(LEVELS))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for name, light_field in scenes(arguments.data, arguments.scenes, size=arguments.size):
        assert light_field.truth is not None
        maps, captions = [], []
        for method in arguments.methods:
            mine, undisturbed = curves(name, light_field, method, arguments.only)
            rows += mine
            maps.append(undisturbed)
            captions.append(f"MSE x 100: {mine[0]['MSE*100']:.2f}")
        here = [row for row in rows if row["scene"] == name]
        print_table(here, title=name)
        names, truth = arguments.methods, light_field.truth.disparity
        compared = plot_comparison(maps, truth, names=names, captions=captions)
        compared.savefig(arguments.out / f"figure_b_7_{name}.png")
        _plot(here).savefig(arguments.out / f"figure_b_3_{name}.png")
        write_csv(arguments.out / "figures_b.csv", rows)
        write_json(arguments.out / "figures_b.json", rows)


def _plot(rows: list[dict[str, Any]]) -> Figure:
    """Errors over the disturbance: a column per figure, a curve per method."""
    figures = list(dict.fromkeys(row["figure"] for row in rows))
    picture = Figure(figsize=(3.6 * len(figures), 5.2), layout="constrained")
    panels = picture.subplots(2, len(figures), squeeze=False, sharex="col")
    for column, figure in zip(panels.T, figures, strict=True):
        for axes, score in zip(column, ("MSE*100", "Q25*100"), strict=True):
            for method in dict.fromkeys(row["method"] for row in rows):
                mine = [r for r in rows if r["figure"] == figure and r["method"] == method]
                axes.plot([r["level"] for r in mine], [r[score] for r in mine], "o-", label=method)
            axes.set(ylabel=score, ylim=(0, None))
        column[0].set_title(figure)
        column[1].set_xlabel(LEVELS[figure][0])
        if figure == "B.5":
            column[0].set(xscale="log")
            column[0].invert_xaxis()
    panels[0, 0].legend()
    return picture


if __name__ == "__main__":
    main()
