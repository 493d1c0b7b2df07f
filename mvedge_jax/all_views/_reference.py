"""Measurement, in other views, of the surfaces that the center view does not show."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._checkpoint import checkpoint
from mvedge_jax._cpu import checkpoint_stage
from mvedge_jax._product import product
from mvedge_jax._root import safe_sqrt
from mvedge_jax.diffusion import AutoSolver, System, diffuse
from mvedge_jax.image import highest
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry import CalibratedViews, Noise, PreparedViews, prepare_views, recenterd
from mvedge_jax.photometry.brightness import Exposure, low_pass
from mvedge_jax.photometry.matching import hypotheses
from mvedge_jax.photometry.measuring import NormalEquations, labels, residual_variance
from mvedge_jax.smoothness import edge_smoothness

from ._draw import STEP, decided, drawn
from ._model import ViewDepth
from ._samples import Samples, added

# Weight of the map itself, so that every region has a label.
_ANCHOR = 1e-6
# A hypothesis replaces the surface behind if its residual is smaller by this factor.
_CLEARLY = 2.0
# Standard errors are diffused to this many times the tolerance of disparities.
_COARSER = 10
# Number of views, besides two, at which the weight of a residual is halved.
_FEW = 4.0
# The four corners of the grid, each turned slightly towards the next arm: if corners are missing,
# the four arms are found instead.
_CORNERS = ((-1.0, -1.01), (1.01, -1.0), (1.0, 1.01), (-1.01, 1.0))


def outermost(light_field: LightField) -> Int[Array, "r 2"]:
    """Indices `(v, u)` of the views that show most of the surfaces hidden from the center view.

    The available views farthest towards the corners; the two ends of a single row or column.
    """
    rows, columns = light_field.available.shape
    corners = np.asarray(_CORNERS)[::2] if min(rows, columns) == 1 else np.asarray(_CORNERS)
    away = -light_field.steps.reshape(-1, 2)
    far = product(jnp.asarray(corners, away.dtype), away.T)
    best = jnp.argmax(jnp.where(light_field.available.ravel(), far, -jnp.inf), axis=1)
    return jnp.stack([best // columns, best % columns], axis=1).astype(jnp.int32)


def _contradicted(
    samples: Samples, disparity: Float[Array, "y x"], step: Float[Array, "2"]
) -> Bool[Array, "y x"]:
    """Pixels of a view whose surface the center view would show in front, but does not."""
    height, width = disparity.shape
    center = lax.stop_gradient(samples.disparity[: height * width]).reshape(height, width)
    disparity = lax.stop_gradient(disparity)
    nearest = highest(center, 1)
    columns = jnp.arange(width, dtype=disparity.dtype)[None]
    rows = jnp.arange(height, dtype=disparity.dtype)[:, None]
    x = jnp.floor(columns - step[0] * disparity + 0.5).astype(jnp.int32)
    y = jnp.floor(rows - step[1] * disparity + 0.5).astype(jnp.int32)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    there = nearest[jnp.clip(y, 0, height - 1), jnp.clip(x, 0, width - 1)]
    return inside & (disparity > there + STEP)


class _Reference(NamedTuple):
    """A view as the center of its own crosshair."""

    scene: CalibratedViews
    prepared: PreparedViews


def uncovered(
    samples: Samples, light_field: LightField, exposure: Exposure, noise: Noise, model: ViewDepth
) -> tuple[Samples, Int[Array, ""]]:
    """Adds the surfaces that the outermost views show and the center view does not.

    Views are processed in turn: pixels of a view that no sample explains are measured there,
    around a first guess that continues the surface behind. Returns all samples, and the number of
    samples to add, with overflow. Differentiable.
    """

    def add(state: tuple[Samples, Array], view: Array) -> tuple[tuple[Samples, Array], None]:
        samples, count = state
        found = checkpoint_stage(_measured_in)(samples, light_field, view, exposure, noise, model)
        step = light_field.steps[view[0], view[1]]
        disparity, error, new = found
        new = new & ~_contradicted(samples, disparity, step)
        return added(samples, disparity, error, new, step, count=count), None

    state = (samples, jnp.zeros((), jnp.int32))
    return lax.scan(checkpoint(add), state, outermost(light_field))[0]


def _measured_in(
    samples: Samples,
    light_field: LightField,
    view: Array,
    exposure: Exposure,
    noise: Noise,
    model: ViewDepth,
) -> tuple[Float[Array, "y x"], Float[Array, "y x"], Bool[Array, "y x"]]:
    """Disparity and standard error of a view, and which pixels the samples do not explain."""
    shape = (light_field.views.shape[2], light_field.views.shape[3])
    scene = recenterd(light_field, view, exposure, noise, params=model.brightness.noise)
    reference = _Reference(scene, prepare_views(scene, model.measurement))
    picture = jnp.moveaxis(light_field.views[view[0], view[1]], -1, 0)
    first = drawn(samples, light_field.steps[view[0], view[1]], shape)
    drawing = decided(first, samples, picture, noise.deviation, model.outline)
    known = samples.disparity[drawing.sample]
    # Pixels covered by the front only through rounding to whole pixels are new, too.
    new = drawing.hole | (samples.disparity[first.sample] - known > STEP)
    # Errors inflated by depth steps are capped; those of unmeasured pixels are kept.
    doubt = samples.error[drawing.sample]
    doubt = jnp.minimum(doubt, jnp.maximum(safe_sqrt(jnp.var(known)), jnp.min(doubt)))

    guess, found = _guess(reference, known, new, model)

    def solve(state: tuple[Array, Array, NormalEquations], more: Array) -> Any:
        disparity, _, found = state
        seen = reference.prepared.params
        measured = labels(found, reference.scene.lab, disparity, seen, passes=seen.passes)
        sure = measured.weight(seen, precision=model.precision, trust=model.trust)
        weight = jnp.where(new, sure + _ANCHOR, 1)
        label = jnp.where(new, measured.disparity, known)
        edges = edge_smoothness(reference.scene.lab, disparity, model.smoothness)
        across, down = (model.stiffness * t for t in edges)
        # Standard error of a label of this weight.
        uncertain = model.precision * jnp.sqrt(1 / jnp.clip(weight, 1e-9, 0.99) - 1)
        uncertain = jnp.where(new, uncertain, doubt)

        # A loop, so that the solver, which compiles slowly, is in the program once.
        def diffused(asked: tuple[Array, Array, Array]) -> Array:
            values, start, tolerance = asked
            solver = AutoSolver(tolerance=tolerance, by_residual=True)
            return diffuse(System(weight, values, across, down), start=start, solver=solver).value

        tolerances = model.tolerance * jnp.asarray([1, _COARSER], disparity.dtype)
        values, starts = jnp.stack([label, uncertain]), jnp.stack([disparity, uncertain])
        value, doubted = lax.map(diffused, (values, starts, tolerances))
        disparity, error = jnp.where(new, value, known), jnp.where(new, doubted, doubt)
        found = lax.cond(more, lambda d: _accumulate(reference, d), lambda _: found, disparity)
        return (disparity, error, found), None

    more = jnp.arange(model.solves) < model.solves - 1
    (disparity, error, _), _ = lax.scan(checkpoint(solve), (guess, doubt, found), more)
    return disparity, error, new


def _accumulate(reference: _Reference, disparity: Array) -> NormalEquations:
    return reference.prepared.accumulate(disparity).per_pixel()


def _guess(
    reference: _Reference, known: Array, new: Array, model: ViewDepth
) -> tuple[Array, NormalEquations]:
    """Initial disparity of new surfaces, and the normal equations there.

    New pixels continue the surface behind, unless the residual of a hypothesis is much smaller.
    """
    scene, seen = reference.scene, reference.prepared
    low, high = jnp.min(known), jnp.max(known)
    # Half the resolution is enough for a guess and halves the disparities.
    arms = scene.arms.mapped(low_pass(scene.noise)).mapped(_halved)
    tried = low / 2 + (high - low) / 2 * jnp.linspace(0, 1, model.hypotheses, dtype=known.dtype)
    half = hypotheses(
        arms, _halved(scene.lab), tried, model.matching, noise=scene.noise, window=2
    ).disparity
    other = jnp.repeat(jnp.repeat(2 * half, 2, axis=0), 2, axis=1)
    height, width = known.shape
    other = jnp.pad(other, ((0, height % 2), (0, width % 2)), mode="edge")[:height, :width]
    other = jnp.where(new, other, known)

    def tried_at(disparity: Array) -> tuple[NormalEquations, Array]:
        found = _accumulate(reference, disparity)
        passes = seen.params.passes
        differs = residual_variance(found, scene.lab, disparity, seen.params, passes=passes)
        # Agreement of few views is weak evidence.
        few = 1 + _FEW / jnp.maximum(found.freedom, 0.1)
        return found, (differs + seen.params.noise**2) * few

    found, residual = lax.map(checkpoint(tried_at), jnp.stack([known, other]))
    better = new & (_CLEARLY * residual[1] < residual[0])
    # The chosen map has been measured already.
    found = jax.tree.map(lambda both: jnp.where(better, both[1], both[0]), found)
    return jnp.where(better, other, known), found


def _halved(planes: Float[Array, "*c y x"]) -> Float[Array, "*c h w"]:
    """Means over 2x2 pixels; an odd row or column at the end is left out, a single one kept."""
    lacking = [(0, 0)] * (planes.ndim - 2) + [(0, max(0, 2 - size)) for size in planes.shape[-2:]]
    planes = jnp.pad(planes, lacking, mode="edge")
    height, width = planes.shape[-2] // 2, planes.shape[-1] // 2
    even = planes[..., : 2 * height, : 2 * width]
    return jnp.mean(even.reshape(*planes.shape[:-2], height, 2, width, 2), axis=(-3, -1))
