"""A correction of a map by the views, with their agreement."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.image import gaussian
from mvedge_jax.losses import Views
from mvedge_jax.photometry.measuring import AdaptedMeasurement, ViewSplines, labels
from mvedge_jax.photometry.views import GridShift, ViewSet
from mvedge_jax.smoothness import ColorAndDepth, edge_smoothness

# Radius of Gaussians over regions, px.
_REGION_REACH = 12


class ViewAgreement(eqx.Module):
    """Parameters of the agreement of two halves of the views, and of the diffused correction.

    Attributes:
        measuring: parameters of the measurement in the views.
        depth_step: pixels beside a larger jump of the map, px, are not measured, because their
            colors are mixtures.
        largest: prior standard deviation of corrections, px; also their limit.
        error: error of the map's labels, px; the weight of evidence is bounded by it.
        smoothness: smoothness of the correction relative to the evidence.
        region: radius of the regions over which both halves of the views have to agree, px.
        edges: where the correction may jump.
    """

    measuring: AdaptedMeasurement = eqx.field(default_factory=AdaptedMeasurement)
    depth_step: Float[Array, ""] = number(0.1)
    largest: Float[Array, ""] = number(0.1)
    error: Float[Array, ""] = number(0.004)
    smoothness: Float[Array, ""] = number(1.0)
    region: Float[Array, ""] = number(3.0)
    edges: ColorAndDepth = eqx.field(default_factory=ColorAndDepth)


class Correction(NamedTuple):
    """A correction that both halves of the views support.

    Attributes:
        change: to add to the map, px per view step, smooth within surfaces.
        weight: weight of the correction, in [0, 1].
        share: share of one half's correction that the other half of the views confirms, in [0, 1].
    """

    change: Float[Array, "y x"]
    weight: Float[Array, "y x"]
    share: Float[Array, "y x"]


@lean_jit
def agreed_correction(
    views: Views,
    disparity: Float[Array, "y x"],
    params: ViewAgreement,
    *,
    radius: int,
    passes: int = 2,
    margin: int = 5,
) -> Correction:
    r"""Corrects a map, px per view step, as far as held-out views confirm it.

    The views are split like a chessboard. Each half proposes a correction u, diffused within
    surfaces. The accepted share of u is the one that explains the other half's measurement m best
    in the region around, $\alpha = \sum w\,m\,u / \sum w\,u^2$, within [0, 1]. Noise is not
    confirmed and vanishes, without a threshold. The result is the mean of both halves; one without
    views proposes and confirms nothing.

    Pixels within `margin` of a depth step are not measured, because their windows reach across it;
    `radius` is the largest distance of occluders, px.
    """
    params = cast(params, disparity.dtype)
    lab = jnp.moveaxis(srgb_to_lab(jnp.moveaxis(views.center, 0, -1)), -1, 0)
    tx, ty = edge_smoothness(lab, disparity, params.edges)
    solver = AutoSolver(tolerance=jnp.asarray(1e-4, disparity.dtype))
    clear = _unbent(disparity, params.depth_step, margin)
    steps = jnp.pad(views.steps, ((1, 0), (0, 0))).astype(views.center.dtype)
    splines = _splines(views, GridShift(steps))
    # A view's step is odd or even; the center view belongs to both halves.
    odd = jnp.mod(jnp.round(jnp.sum(steps, axis=1)), 2) == 1
    center = jnp.all(steps == 0, axis=1)
    measuring = replace(params.measuring, radius=radius)

    def propose(half: Bool[Array, "k"]) -> tuple[Array, Array, Array]:
        part = splines._replace(available=splines.available & (half | center))
        found = part.accumulate(disparity, measuring)
        measured = labels(found, lab, disparity, measuring, passes=passes)
        # A pixel without a measurement has weight 0, instead of a change of 0.
        known = jnp.where(clear, 1 / measured.variance, 0)
        told = known / (known + 1 / params.largest**2)
        change = params.largest * jnp.tanh(told * (measured.disparity - disparity) / params.largest)
        weight = known * params.error**2 / (1 + known * params.error**2)
        stiff = params.smoothness
        system = System(weight + 1e-6, change, stiff * tx, stiff * ty)
        return diffuse(system, solver=solver).value, change, weight

    proposed, measured, weight = lax.map(propose, jnp.stack([odd, ~odd]))
    other_measured, other_weight = measured[::-1], weight[::-1]
    blur = partial(gaussian, sigma=params.region, radius=_REGION_REACH)
    confirmed = blur(other_weight * other_measured * proposed)
    asked = blur(other_weight * proposed**2)
    tiny = jnp.asarray(1e-14, disparity.dtype)
    share = jnp.clip(confirmed / (asked + tiny), 0, 1)
    change = jnp.mean(share * proposed, axis=0)
    return Correction(change, jnp.mean(weight, axis=0), jnp.mean(share, axis=0))


def _splines(views: Views, shifts: GridShift) -> ViewSplines:
    """All views with the center one first."""
    images = jnp.concatenate([views.center[None], views.others])
    there = jnp.pad(views.available, (1, 0), constant_values=True)
    return ViewSplines.of(ViewSet(images, shifts, there))


def _unbent(disparity: Array, step: Array, margin: int) -> Bool[Array, "y x"]:
    """Where the map does not bend by `step` within `margin` pixels; slants are no steps."""
    p = jnp.pad(disparity, 1, mode="edge")
    across = jnp.abs(p[1:-1, 2:] - 2 * disparity + p[1:-1, :-2])
    down = jnp.abs(p[2:, 1:-1] - 2 * disparity + p[:-2, 1:-1])
    smooth = jnp.maximum(across, down) < step
    return _shrink(smooth, margin - 1)


def _shrink(mask: Bool[Array, "y x"], times: int) -> Bool[Array, "y x"]:
    """Erodes a mask; the image's border is not eroded."""
    for _ in range(times):
        p = jnp.pad(mask, 1, constant_values=True)
        mask = mask & p[:-2, 1:-1] & p[2:, 1:-1] & p[1:-1, :-2] & p[1:-1, 2:]
    return mask
