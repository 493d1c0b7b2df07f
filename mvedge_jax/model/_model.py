"""The differentiable model: points and a smoothness map that render to a disparity map."""

import warnings
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy, cast, jax_array, number
from mvedge_jax._paths import Replaceable, replaced
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.diffusion import AutoSolver, Pairing, SolveStats, System, diffuse, edge_weights
from mvedge_jax.splatting import Splat, SplatLabels

# Steps of disparity, px, and of Lab at which a map is rough; and the largest roughness.
_DEPTH_STEP, _COLOR_STEP, _LARGEST = 0.05, 0.3, 10.0


class DepthModel(eqx.Module):
    """The parameter set Θ of the thesis, unconstrained.

    Attributes:
        disparity: Z, label of each point, px per view step.
        xy: positions, image pixels.
        log_weight: R; the data weight of a point is `exp(-R)`.
        roughness: Q; the smoothness of a pixel is `exp(-Q)`.
        valid: points that take part; the other slots are free.
    """

    disparity: Float[Array, "n"] = eqx.field(converter=jax_array)
    xy: Float[Array, "n 2"] = eqx.field(converter=jax_array)
    log_weight: Float[Array, "n"] = eqx.field(converter=jax_array)
    roughness: Float[Array, "y x"] = eqx.field(converter=jax_array)
    valid: Bool[Array, "n"] = eqx.field(converter=jax_array)


def without_free_places(model: DepthModel) -> DepthModel:
    """Drops the slots of a model, not traced, that hold no point."""
    there = np.flatnonzero(np.asarray(model.valid))
    points = jax.tree.map(lambda leaf: leaf[there], _points_of(model))
    return eqx.tree_at(_points_of, model, points)


def with_capacity(model: DepthModel, capacity: int) -> DepthModel:
    """Appends free slots to a model until it has as many as `capacity`."""
    extra = capacity - model.valid.size
    if extra < 0:
        raise ValueError(
            f"`capacity` is {capacity}, but the model has {model.valid.size} places already."
        )

    def padded(leaf: Array) -> Array:
        return jnp.pad(leaf, [(0, extra)] + [(0, 0)] * (leaf.ndim - 1))

    return eqx.tree_at(_points_of, model, jax.tree.map(padded, _points_of(model)))


def _points_of(model: DepthModel) -> tuple[Any, ...]:
    return model.disparity, model.xy, model.log_weight, model.valid


class Renderer(Replaceable):
    """Renders a model to a map: labels, smoothness, diffusion.

    This is the second half of `EdgeDepth` with free points and a free smoothness map.

    Attributes:
        splat: puts the points' labels onto a raster; by default narrow points, see `on_raster`.
        solver: solver of the diffusion: one of `mvedge_jax.diffusion` or any solver of Lineax for
            symmetric operators.
        clearing: c; with `clears`, a point of weight w has the opacity `1 - exp(-c w)`.
        normalized: divide labels by their coverage.
        clears: a point that loses its weight loses its opacity, too, and uncovers the points
            behind it; in the thesis it hides them. In `experiments/hidden_points.py`, where 70 % of
            the points are hidden, this lowers the error after the optimization by 1 %, recycling
            hidden points (`Growth`) by 5 %, both by 14 %, narrow points by 66 %, all by 98 %.
        pairing: how an edge combines the smoothness of two pixels, see `edge_weights`.

    Example:
        >>> Renderer.on_raster(2).splat.raster.radius
        4
    """

    splat: SplatLabels = eqx.field(default_factory=SplatLabels)
    solver: lx.AbstractLinearSolver = eqx.field(default_factory=AutoSolver)
    clearing: Float[Array, ""] = number(4.0)
    normalized: bool = eqx.field(static=True, default=True)
    clears: bool = eqx.field(static=True, default=True)
    pairing: Pairing = eqx.field(static=True, default="min")

    @staticmethod
    def on_raster(scale: int) -> "Renderer":
        """Narrow points on a raster of any scale, see `SplatLabels.on_raster`.

        A point of the thesis' width hides the pixels beside it from other points: fitted to the
        synthetic scene "edges" at 512x512, with points added, the model ends at a mean squared
        error (times 100) of 0.08 with that width, and below 0.001 with narrow points
        (`experiments/figure_7_10.py`). `scale` is 1 or 2 raster pixels per pixel and axis; the
        thesis has 2, 1 takes a quarter of the time.
        """
        return Renderer(SplatLabels.on_raster(scale))

    @staticmethod
    def thesis() -> "Renderer":
        """The thesis' renderer to the letter.

        `SplatLabels.thesis` with a quadrature of 8 samples along the ray, labels that are not
        divided by their coverage, and points that hide others whatever they weigh.
        """
        splat = replaced(SplatLabels.thesis(), {"raster.absorption": "quadrature"})
        return Renderer(splat, normalized=False, clears=False)


class Rendered(eqx.Module):
    """A rendered map, px per view step, its splatted labels, and the statistics of the solve."""

    disparity: Float[Array, "y x"]
    splat: Splat
    stats: SolveStats

    def problems(self) -> tuple[str, ...]:
        """Problems of the splat and the solve, one sentence each; on the host."""
        unsolved = "the diffusion stopped before its tolerance."
        return self.splat.problems() + (() if bool(self.stats.converged) else (unsolved,))


def upsample(image: Float[Array, "y x"], scale: int) -> Float[Array, "y2 x2"]:
    """Interpolates linearly onto a raster with `scale` (1 or 2) pixels per pixel and axis.

    Pixel areas coincide: raster pixel `k` is centered at `(k + 1/2) / scale - 1/2`. The authors'
    align-corners form drifts by up to a raster pixel over the image.
    """
    if scale == 1:
        return image
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (1, 1)
        padded = jnp.pad(image, margin, mode="edge")
        before, after = (
            jax.lax.slice_in_dim(padded, start, start + image.shape[axis], axis=axis)
            for start in (0, 2)
        )
        pair = jnp.stack([0.75 * image + 0.25 * before, 0.75 * image + 0.25 * after], axis + 1)
        shape = list(image.shape)
        shape[axis] *= 2
        image = pair.reshape(shape)
    return image


def downsample(raster: Float[Array, "y2 x2"], scale: int) -> Float[Array, "y x"]:
    """Means over the raster pixels of every pixel."""
    height, width = raster.shape
    blocks = raster.reshape(height // scale, scale, width // scale, scale)
    return jnp.mean(blocks, axis=(1, 3))


def opacities(model: DepthModel, renderer: Renderer) -> Float[Array, "n"] | None:
    """Opacity of each point, or None where all are opaque."""
    if not renderer.clears:
        return None
    return -jnp.expm1(-renderer.clearing * jnp.exp(-model.log_weight))


def splat_model(
    model: DepthModel,
    weight: Float[Array, "n"],
    opacity: Float[Array, "n"] | None,
    renderer: Renderer,
) -> Splat:
    """Splats the model's points onto its raster."""
    height, width = model.roughness.shape
    return renderer.splat(
        model.xy, model.disparity, weight, model.valid, (height, width), opacity=opacity
    )


def warn_where_known(maps: Splat, *, level: int = 2) -> None:
    """Warns of `Splat.problems`, unless they are traced; `level` frames above the caller."""
    if not any(isinstance(number, Tracer) for number in (maps.cut_off, maps.overflow)):
        for problem in maps.problems():
            warnings.warn(problem, stacklevel=level + 1)


@accepts_numpy
def render_model(
    model: DepthModel, renderer: Renderer, *, start: Float[Array, "y x"] | None = None
) -> Rendered:
    """Renders the model: splat the points, diffuse their labels, average down to pixels.

    Args:
        model: points and smoothness.
        renderer: widths, density, solver.
        start: a map near the solution, to save iterations; not differentiated.

    Returns:
        The map. Differentiable with respect to the floating leaves of `model`, `renderer.splat` and
        `renderer.clearing`. Points that the splat cuts off or leaves out raise a warning, and too
        wide ones an error. Under `jit`, check `Rendered.problems` instead.

    Source:
        Thesis 7.1, Eq. 7.2-7.14.
    """
    renderer = cast(renderer, model.disparity.dtype)
    scale = renderer.splat.raster.scale
    weight = jnp.exp(-model.log_weight)
    maps = splat_model(model, weight, opacities(model, renderer), renderer)
    warn_where_known(maps, level=3)
    smoothness = jnp.exp(-upsample(model.roughness, scale))
    tx, ty = edge_weights(smoothness, pairing=renderer.pairing)
    label = maps.label if renderer.normalized else maps.label_sum
    system = System(maps.weight, label, tx, ty)
    guess = None if start is None else upsample(start, scale)
    solved = diffuse(system, start=guess, solver=renderer.solver)
    return Rendered(downsample(solved.value, scale), maps, solved.stats)


def map_roughness(
    disparity: Float[Array, "y x"], center: Float[Array, "y x c"]
) -> Float[Array, "y x"]:
    r"""Initial Q >= 0 from a map and its image: rough where both have a step.

    $Q = \ln(1 + (|\Delta Lab| / .3)^{1.5} (|\Delta D| / .05)^2)$, D in px, the largest over a
    pixel's edges. Only the product of both steps is reliable: either alone leaks or cuts too much.
    """
    lab = srgb_to_lab(center)
    rough = jnp.zeros_like(disparity)
    for axis in (0, 1):
        color = jnp.sqrt(jnp.sum(jnp.diff(lab, axis=axis) ** 2, axis=-1) + 1e-12)
        depth = jnp.diff(disparity, axis=axis) / _DEPTH_STEP
        edge = jnp.minimum(jnp.log1p(depth**2 * (color / _COLOR_STEP) ** 1.5), _LARGEST)
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 0)
        rough = jnp.maximum(rough, jnp.pad(edge, pad))
    return rough
