"""The differentiable model: points and a smoothness map that render to a disparity map."""

import warnings
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy, cast, jax_array, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.diffusion import (
    AbstractSolver,
    AutoSolver,
    Pairing,
    SolveStats,
    System,
    diffuse,
    edge_weights,
)
from mvedge_jax.splatting import Splat, SplatParams, SplatSizes, splat


class DepthModel(eqx.Module):
    """The parameter set Θ of the thesis, unconstrained.

    Attributes:
        disparity: Z, label of each point, px per view step.
        xy: positions, image pixels.
        log_weight: R; the data weight of a point is `exp(-R)`.
        roughness: Q; the smoothness of a pixel is `exp(-Q)`.
        valid: points that take part; the others are free capacity.
    """

    disparity: Float[Array, "n"] = eqx.field(converter=jax_array)
    xy: Float[Array, "n 2"] = eqx.field(converter=jax_array)
    log_weight: Float[Array, "n"] = eqx.field(converter=jax_array)
    roughness: Float[Array, "y x"] = eqx.field(converter=jax_array)
    valid: Bool[Array, "n"] = eqx.field(converter=jax_array)


class ModelParams(eqx.Module):
    """Continuous hyperparameters of the rendering.

    Attributes:
        splat: widths and density of points.
        solver: of the diffusion.
        clearing: c; a point of weight w has the opacity `1 - exp(-c w)` if `ModelSizes.clears`.
    """

    splat: SplatParams = eqx.field(default_factory=SplatParams)
    solver: AbstractSolver = eqx.field(default_factory=AutoSolver)
    clearing: Float[Array, ""] = number(4.0)

    @staticmethod
    def narrow(scale: int) -> "ModelParams":
        """Points that are narrower than the thesis', for a raster of any scale.

        The defaults are the thesis' widths, on its raster of 2: labels of 0.65 px. Such a point
        hides the pixels beside it, so that no other can speak there, however it is optimised:
        fitted to the synthetic scene "edges" at 512x512, with points added, the model ends at a
        mean squared error (times 100) of 0.08 with that width, and below 0.001 with this one
        (`experiments/figure_7_10.py`).

        Args:
            scale: raster pixels per pixel and axis, as in `SplatSizes`.

        Returns:
            Parameters with labels of 0.35 px and weights of 0.45 px.

        Example:
            >>> round(float(ModelParams.narrow(2).splat.sigma_label), 2)
            0.7
        """
        label, weight = jnp.asarray(0.35 * scale), jnp.asarray(0.45 * scale)
        return ModelParams(splat=SplatParams(sigma_label=label, sigma_weight=weight))


@dataclass(frozen=True)
class ModelSizes:
    """Static choices of the rendering.

    Attributes:
        splat: of the splat; its `scale` is the raster's.
        normalised: divide labels by their coverage.
        clears: a point that loses its weight loses its opacity too, so that what it hides comes
            back. In the thesis a point hides what is behind it whatever its weight. In
            `experiments/hidden_points.py`, where 70 % of the points are hidden, many by wrong
            ones, this alone lowers the error after the optimisation by 1 %, recycling hidden
            points (`grow`) by 5 %, both together by 14 %. Narrower points
            (`ModelParams.narrow`) hide 5 % of the points from the start: they lower it by
            66 %, and all three together by 98 %.
        pairing: how two pixels' smoothness makes an edge's, see `edge_weights`.
    """

    splat: SplatSizes = field(default_factory=SplatSizes)
    normalised: bool = True
    clears: bool = True
    pairing: Pairing = "min"

    @staticmethod
    def on_raster(scale: int) -> "ModelSizes":
        """Sizes for points as narrow as those of `ModelParams.narrow`, on a raster of any scale.

        Such points end within two pixels (the opacity that is cut off is below 2e-6, which only
        differences in float64 see), so that tiles are small and have few of each other's points: a
        step of the optimisation takes a third of the time that it takes with tiles for the thesis'
        widths, `SplatSizes()`.

        Args:
            scale: raster pixels per pixel and axis; the thesis has 2, 1 takes a quarter of the
                time.

        Returns:
            The sizes.

        Example:
            >>> ModelSizes.on_raster(1).splat.radius
            2
        """
        return ModelSizes(
            splat=SplatSizes(scale=scale, radius=2 * scale, tile=4 * scale, lanes=512)
        )

    def rendering(self, asked: ModelParams | None) -> ModelParams:
        """What was asked for, or points that are narrow on this raster.

        Args:
            asked: None for `ModelParams.narrow`.

        Returns:
            The parameters of the rendering.

        Raises:
            ValueError: the points are wider than `splat.radius` lets them be.
        """
        rendering = ModelParams.narrow(self.splat.scale) if asked is None else asked
        self.splat.check(rendering.splat)
        return rendering


class Rendered(eqx.Module):
    """A rendered map, what it was diffused from, and how the solve went.

    Attributes:
        disparity: the map, px per view step.
        splat: the labels and weights on the raster.
        stats: of the solve.
    """

    disparity: Float[Array, "y x"]
    splat: Splat
    stats: SolveStats

    def problems(self) -> tuple[str, ...]:
        """What the splat and the solve say against the map, one sentence each; on the host."""
        unsolved = "the diffusion stopped before its tolerance."
        return self.splat.problems() + (() if bool(self.stats.converged) else (unsolved,))


def upsample(image: Float[Array, "y x"], scale: int) -> Float[Array, "y2 x2"]:
    """Interpolates linearly onto a raster with `scale` (1 or 2) pixels per pixel and axis.

    Pixel areas coincide: raster pixel `k` is centred at `(k + 1/2) / scale - 1/2`. The authors'
    align-corners form drifts by up to a raster pixel over the image.

    Args:
        image: one value per pixel.
        scale: raster pixels per pixel and axis, 1 or 2.

    Returns:
        One value per raster pixel. Differentiable.
    """
    if scale == 1:
        return image
    for axis in (0, 1):
        before = jnp.concatenate(
            [jax.lax.slice_in_dim(image, 0, 1, axis=axis),
             jax.lax.slice_in_dim(image, 0, image.shape[axis] - 1, axis=axis)], axis
        )  # fmt: skip
        after = jnp.concatenate(
            [jax.lax.slice_in_dim(image, 1, image.shape[axis], axis=axis),
             jax.lax.slice_in_dim(image, image.shape[axis] - 1, image.shape[axis], axis=axis)],
            axis,
        )  # fmt: skip
        pair = jnp.stack([0.75 * image + 0.25 * before, 0.75 * image + 0.25 * after], axis + 1)
        shape = list(image.shape)
        shape[axis] *= 2
        image = pair.reshape(shape)
    return image


def downsample(raster: Float[Array, "y2 x2"], scale: int) -> Float[Array, "y x"]:
    """Means over the raster pixels of every pixel.

    Args:
        raster: one value per raster pixel.
        scale: raster pixels per pixel and axis.

    Returns:
        One value per pixel. Differentiable.
    """
    height, width = raster.shape
    blocks = raster.reshape(height // scale, scale, width // scale, scale)
    return jnp.mean(blocks, axis=(1, 3))


def to_raster(xy: Float[Array, "n 2"], scale: int) -> Float[Array, "n 2"]:
    """Raster coordinates of image positions."""
    return scale * xy + (scale - 1) / 2


def opacities(
    model: DepthModel, params: ModelParams, sizes: ModelSizes
) -> Float[Array, "n"] | None:
    """Opacity of each point, or None where all are opaque."""
    if not sizes.clears:
        return None
    return -jnp.expm1(-params.clearing * jnp.exp(-model.log_weight))


def splat_model(
    model: DepthModel,
    weight: Float[Array, "n"],
    opacity: Float[Array, "n"] | None,
    params: ModelParams,
    sizes: ModelSizes,
) -> Splat:
    """Splats the model's points onto its raster."""
    scale = sizes.splat.scale
    height, width = model.roughness.shape
    return splat(
        to_raster(model.xy, scale),
        model.disparity,
        weight,
        model.valid,
        params.splat,
        (height * scale, width * scale),
        sizes.splat,
        opacity=opacity,
    )


def warn_where_known(maps: Splat, *, level: int = 2) -> None:
    """Warns of `Splat.problems`, unless they are traced; `level` frames above the caller."""
    if not any(isinstance(number, Tracer) for number in (maps.cut_off, maps.overflow)):
        for problem in maps.problems():
            warnings.warn(problem, stacklevel=level + 1)


@accepts_numpy
def render_model(
    model: DepthModel,
    params: ModelParams,
    sizes: ModelSizes,
    *,
    start: Float[Array, "y x"] | None = None,
) -> Rendered:
    """Renders the model: splat the points, diffuse their labels, average down to pixels.

    Args:
        model: points and smoothness.
        params: widths, density, solver.
        sizes: static choices.
        start: a map near the solution, to save iterations; not differentiated.

    Returns:
        The map. Differentiable with respect to the floating leaves of `model` and `params.splat`.
        Points that the splat cuts off or leaves out raise a warning, and too wide ones an error.
        Under `jit` neither is seen: ask `Rendered.problems` there.

    Source:
        Thesis 7.1, Eq. 7.2-7.14.
    """
    scale = sizes.splat.scale
    params = cast(params, model.disparity.dtype)
    weight = jnp.exp(-model.log_weight)
    maps = splat_model(model, weight, opacities(model, params, sizes), params, sizes)
    warn_where_known(maps, level=3)
    smoothness = jnp.exp(-upsample(model.roughness, scale))
    tx, ty = edge_weights(smoothness, pairing=sizes.pairing)
    label = maps.label if sizes.normalised else maps.label_sum
    system = System(maps.weight, label, tx, ty)
    guess = None if start is None else upsample(start, scale)
    solved = diffuse(system, start=guess, solver=params.solver)
    return Rendered(downsample(solved.value, scale), maps, solved.stats)


def image_roughness(centre: Float[Array, "y x c"], gain: Float[Array, ""]) -> Float[Array, "y x"]:
    """Initial Q: the magnitude of the image gradient, as in the thesis.

    Args:
        centre: the centre view, sRGB.
        gain: Q per unit of L* per pixel.

    Returns:
        Q, zero where the image is flat.

    Source:
        Thesis 7.1.5.
    """
    lightness = srgb_to_lab(centre)[..., 0]
    padded = jnp.pad(lightness, 1, mode="edge")
    gx = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2
    gy = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    return gain.astype(centre.dtype) * jnp.sqrt(gx**2 + gy**2 + 1e-12)


def map_roughness(
    disparity: Float[Array, "y x"],
    centre: Float[Array, "y x c"] | None,
    *,
    depth_step: Float[Array, ""] | float = 0.05,
    colour_step: Float[Array, ""] | float = 0.3,
    largest: Float[Array, ""] | float = 10.0,
) -> Float[Array, "y x"]:
    r"""Initial Q from a map that is already there: rough where it steps, and the image with it.

    $Q = \ln(1 + (|\Delta Lab| / c)^{1.5} (|\Delta D| / d)^2)$, the largest over a pixel's
    edges. The product of both steps matters: either alone leaks or cuts too much.

    Args:
        disparity: a first map.
        centre: the image; with None only the map counts.
        depth_step: d, px.
        colour_step: c, units of Lab.
        largest: Q is clipped at this.

    Returns:
        Q >= 0.
    """
    dtype = disparity.dtype
    depth_step, colour_step, largest = (
        jnp.asarray(value).astype(dtype) for value in (depth_step, colour_step, largest)
    )
    lab = None if centre is None else srgb_to_lab(centre)
    rough = jnp.zeros_like(disparity)
    for axis in (0, 1):
        term = (jnp.diff(disparity, axis=axis) / depth_step) ** 2
        if lab is not None:
            colour = jnp.sqrt(jnp.sum(jnp.diff(lab, axis=axis) ** 2, axis=-1) + 1e-12)
            term = term * (colour / colour_step) ** 1.5
        edge = jnp.minimum(jnp.log1p(term), largest)
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 0)
        rough = jnp.maximum(rough, jnp.pad(edge, pad))
    return rough
