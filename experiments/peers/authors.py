"""The chain as the authors' published program has it: preset `thesis` with parts of its own.

What the program does beside, or against, the dissertation (`docs/differences.md` names it): one
scale and no vote, tests of crossed lines alone, filters with gaps between labels cut by the labels
themselves, signs along edges by their majority, a second joint filter, a plane sweep around every
label, smoothness by the product of both gradients, a quantized median. Left out are its mistakes:
an entropy search that moves one line of an image, and the corners of its last median.

Figures, constants and steps are from the program's description; no code is.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import as_number, cast, number
from mvedge_jax.color import srgb_to_gray
from mvedge_jax.depth import EdgeDepth, Refine, Sharpen
from mvedge_jax.depth._labels import Labels
from mvedge_jax.diffusion import AutoSolver, System, diffuse, edge_weights
from mvedge_jax.edges import EdgePoints, rasterize
from mvedge_jax.edges.sides import Sides, SideVote, depth_edge_confidence, step_response
from mvedge_jax.edges.sides._profile import profiles, stretched
from mvedge_jax.edges.sides._surface import along_edge, choose
from mvedge_jax.edges.thesis import joint_filter
from mvedge_jax.interpolation import sample
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import Evidence
from mvedge_jax.smoothness import ThesisSmoothness, image_roughness

# Exponents of data weights are cut here, for single precision: the program's grow to e^20.
_LIMIT = 10.0
# Of the joint filter: px, px per view step, sRGB.
_SIGMAS = 5.0, 0.1, 0.5
CHOICES = {
    "edges.lines.floor": 1e-3,
    "edges.lines.capacity": 512,
    "edges.lines.levels": 1,
    "edges.lines.vote": False,
    "edges.lines.alignment": "run",
    "edges.lines.visibility": "crossed",
    "edges.color": "srgb",
    "edges.space_sigma": 5.0,
}


class AuthorsSides(eqx.Module):
    """Directional diffusions whose smoothness is low at labels alone; majority along the edge.

    Attributes:
        data: weight of a label against the smoothness between labels.
        beside: smoothness at labels against that between them.
        gain: of the difference of both responses in the exponent of a data weight.
    """

    data: Float[Array, ""] = number(10.0)
    beside: Float[Array, ""] = number(1e-4)
    gain: Float[Array, ""] = number(1.3, "1/px")
    reach: int = eqx.field(static=True, default=30)

    def __call__(self, points: EdgePoints, evidence: Evidence) -> Sides:
        """See `SideChoice`; the confidence is the exponent of the data weight."""
        params, shape = cast(self, points.disparity.dtype), evidence.shape
        marked = rasterize(points.xy, points.disparity, points.valid, shape).hit
        smooth = jnp.where(marked, params.beside, 1).astype(points.disparity.dtype)
        tx, ty = edge_weights(smooth, pairing="second")

        def solve(sign: Array) -> tuple[Array, Array]:
            place = points.xy + sign * points.normal
            raster = rasterize(place, points.disparity, points.valid, shape)
            weight = params.data * raster.hit.astype(smooth.dtype)
            system = System(weight, raster.values(points.disparity), tx, ty)
            found = diffuse(system, solver=AutoSolver(tolerance=1e-4))
            return found.value, found.stats.iterations

        (forward, backward), iterations = lax.map(solve, jnp.asarray([1.0, -1.0], smooth.dtype))
        ahead, behind = (profiles(m, points.xy, points.normal) for m in (forward, backward))
        ahead_wins = step_response(stretched(ahead)) > step_response(stretched(behind))
        towards = 2 * ahead_wins.astype(smooth.dtype) - 1
        score = along_edge(points, towards, shape=shape, reach=self.reach)
        # The responses are 4.5 times a step there, twice a step here.
        apart = 2.25 * jnp.abs(step_response(ahead) - step_response(behind))
        edge = 2 * depth_edge_confidence(forward, backward)
        initial = 0.5 * (forward + backward)
        surface = choose(points, score, cast(SideVote(), score.dtype))
        return Sides(surface, params.gain * apart, edge, initial, iterations)


class AuthorsLabels(eqx.Module):
    """Labels on their pixels after a second joint filter, a selection and a plane sweep.

    Attributes:
        span: half of the range of the sweep, px.
        least: share of the costs of all disparities below which the lowest one is trusted.
        kept: share of the points with the largest weights.
        sweep: run it.
        hypotheses: disparities of the sweep.
        views: number of the views that show a point, which are compared.
    """

    span: Float[Array, ""] = number(0.25, "px")
    least: Float[Array, ""] = number(0.01)
    kept: Float[Array, ""] = number(0.9)
    sweep: bool = eqx.field(static=True, default=True)
    hypotheses: int = eqx.field(static=True, default=9)
    views: int = eqx.field(static=True, default=8)

    def __call__(
        self, points: EdgePoints, sides: Sides, evidence: Evidence, precision: Float[Array, ""]
    ) -> Labels:
        """See `PointLabels`; no standard error is read."""
        del precision
        dtype, shape = points.disparity.dtype, evidence.shape
        params = cast(self, dtype)
        weight = jnp.where(points.valid, jnp.minimum(sides.confidence, _LIMIT), -1)
        ordered = jnp.sort(jnp.where(points.valid, weight, jnp.inf))
        worst = ((1 - params.kept) * points.valid.sum().astype(dtype)).astype(jnp.int32)
        place = points.xy + sides.surface.offset
        center = jnp.moveaxis(evidence.calibrated.views.center, 0, -1)
        sigmas = [jnp.asarray(sigma, center.dtype) for sigma in _SIGMAS]
        disparity = joint_filter(place, points.disparity, points.valid, center, *sigmas)
        valid = points.valid & (weight >= ordered[worst])
        if self.sweep:
            found = _swept(place, disparity, sides.surface.offset, points.visible, evidence, params)
            disparity, valid = found.disparity, valid & found.known
        raster = rasterize(place, disparity, valid, shape)
        return Labels(raster.values(jnp.exp(weight - _LIMIT)), raster.values(disparity))


class _Found(NamedTuple):
    """Disparities of the sweep, and the points for which it has one."""

    disparity: Float[Array, " n"]
    known: Bool[Array, " n"]


# Points at a time: memory against speed.
_CHUNK = 2048


def _swept(
    place: Float[Array, "n 2"],
    disparity: Float[Array, " n"],
    offset: Float[Array, "n 2"],
    visible: Bool[Array, "n s"],
    evidence: Evidence,
    params: AuthorsLabels,
) -> _Found:
    """The disparity at which most pixels of a patch on the label's surface agree between views.

    5x5 pixels from the label to 5 px along its surface vector, and 2.5 px to either side of it. A
    pixel's vote counts if its variance over the views is far below those at other disparities.
    """
    planes, steps = _gray_views(evidence)
    height, width = planes.shape[1:]
    # One image, so that every point may have views of its own.
    tall, last = planes.reshape(-1, width), height - 1
    shift = jnp.linspace(-params.span, params.span, params.hypotheses, dtype=disparity.dtype)
    along, beside = jnp.meshgrid(jnp.linspace(0, 5, 5), jnp.linspace(-2.5, 2.5, 5))
    patch = jnp.stack([along.reshape(-1), beside.reshape(-1)]).astype(disparity.dtype)

    def one(item: tuple[Array, ...]) -> tuple[Array, Array]:
        xy, own, towards, views = item
        axes = jnp.stack([towards, jnp.stack([-towards[1], towards[0]])])
        pixels = xy[None] + patch.T @ axes
        tried = own + shift

        def seen(view: Array) -> Array:
            x, y = jnp.moveaxis(pixels[None] + tried[:, None, None] * steps[view], -1, 0)
            y = jnp.clip(y, 0, last) + (view * height).astype(y.dtype)
            return sample(tall, jnp.stack([x, y], -1).reshape(-1, 2)).reshape(tried.size, -1)

        cost = jnp.var(jax.vmap(seen)(views), axis=0)
        trusted = cost.min(0) < params.least * cost.sum(0)
        votes = jnp.zeros_like(shift).at[jnp.argmin(cost, axis=0)].add(trusted.astype(own.dtype))
        return tried[jnp.argmax(votes)], trusted.any()

    views = _views_of(visible, params.views)
    return _Found(*lax.map(one, (place, disparity, offset, views), batch_size=_CHUNK))


def _views_of(visible: Bool[Array, "n s"], count: int) -> Int[Array, "n c"]:
    """Numbers of the views that show a point, evenly chosen; some twice where there are fewer."""
    order = jnp.argsort(~visible, axis=-1, stable=True)
    last = jnp.maximum(visible.sum(-1, keepdims=True) - 1, 0)
    chosen = jnp.round(jnp.linspace(0, 1, count) * last).astype(jnp.int32)
    return jnp.take_along_axis(order, chosen, -1)


def _gray_views(evidence: Evidence) -> tuple[Array, Array]:
    """Views of the crosshair as `EdgePoints.visible` has them, and their steps `(x, y)`."""
    across, down = evidence.calibrated.arms
    planes = jnp.concatenate([jnp.swapaxes(down.planes, -1, -2), across.planes])
    flat = jnp.zeros_like(down.steps), jnp.zeros_like(across.steps)
    steps = jnp.concatenate(
        [jnp.stack([flat[0], down.steps], -1), jnp.stack([across.steps, flat[1]], -1)]
    )
    return srgb_to_gray(jnp.moveaxis(planes, 1, -1)), steps


class AuthorsSmoothness(ThesisSmoothness):
    """Smoothness that falls with the product of the gradients of image and directional maps.

    Attributes:
        depth_edge: product at which the smoothness is one half.
        floor: see `PerPixel`.
        pairing: see `PerPixel`.
    """

    # sqrt(1e-5) over 3.922 times Sobel's filters at twice the resolution, 4 times a gradient each.
    depth_edge: Float[Array, ""] = number(1e-5**0.5 / (3.922 * 16), "gray/px px/px")

    def per_pixel(
        self, guide: Float[Array, "c y x"], depth_edge: Float[Array, "y x"]
    ) -> Float[Array, "y x"]:
        """See `PerPixel`."""
        product = image_roughness(guide[0], jnp.asarray(0.01, depth_edge.dtype)) * depth_edge
        return 1 / (1 + (product / self.depth_edge) ** 2)


def authors_model(light_field: LightField) -> EdgeDepth:
    """Preset `thesis` with the authors' options and parts.

    Args:
        light_field: see `EdgeDepth.for_light_field`.

    Returns:
        The model; called with a key, it gives the map.
    """
    model = EdgeDepth.for_light_field(light_field, preset="thesis", choices=CHOICES)
    # Data weights are 1500 e^W against a smoothness of at most 1e4.
    stiffness = 1e4 / 1500 * math.exp(-_LIMIT)
    return model.replace(
        sides=AuthorsSides(),
        labels=AuthorsLabels(),
        smoothness=AuthorsSmoothness(floor=as_number(1e-5)),
        refine=Refine(
            stiffness=as_number(stiffness),
            slopes=None,
            sharpen=Sharpen(mode="quantized", levels=256),
            outline=None,
            solves=1,
        ),
    )
