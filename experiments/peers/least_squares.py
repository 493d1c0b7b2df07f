"""Levenberg-Marquardt for the losses of the model, by Optimistix; matrix-free, by Lineax."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast
from mvedge_jax._root import safe_sqrt
from mvedge_jax.losses import occlusion_masks
from mvedge_jax.losses.terms import _edge_aware_slopes, warp_views
from mvedge_jax.model import DepthModel, render_model
from mvedge_jax.model._host import warn_of_cuts
from mvedge_jax.model.objectives import SelfSupervised, Supervised, Trust
from mvedge_jax.model.optimization._state import parts_of, with_parts

# Largest number of CG steps per step; an unsolved system ends the search.
_LINEAR_STEPS = 300
# Share of the predicted reduction at which damping decreases. Optimistix requires .99, which
# absolute errors never reach, so the initial damping would stay.
_GOOD = 0.75
# Scales below which absolute errors become squares, for features (colors in [0, 1]) and slopes.
_BLUNT_FEATURE, _BLUNT_SLOPE = 2 / 255, 0.01


class Minimized(NamedTuple):
    """The best model found.

    Attributes:
        model: the parameters with the lowest loss.
        disparity: the map that they render, px per view step.
        loss: loss before every step and at the end; a rejected step repeats it.
    """

    model: DepthModel
    disparity: Float[Array, "y x"]
    loss: Float[Array, "steps"]


def minimize_least_squares(
    model: DepthModel,
    objective: Supervised | SelfSupervised,
    start: Float[Array, "y x"],
    *,
    steps: int = 20,
    scales: tuple[float, float, float, float] = (1.0, 0.1, 1.0, 0.2),
    tolerance: float = 0.1,
    blunt: float = 0.01,
    progress: Callable[[int, float], None] | None = None,
) -> Minimized:
    """Minimizes a loss over all parameters at once, by Levenberg-Marquardt steps.

    The Jacobian is never formed: each step of the linear solver applies it by forward mode, and its
    transpose, which costs two diffusions. Runs on the host, one compiled step at a time.

    It needs few, but expensive steps. On the synthetic scene "demo" at 64x64 px, 12 or 13 steps
    reach the loss of 150 iterations of Adam, for the known map, `ByEvidence` and `ByReprojection`,
    in some 20 to 30 times its seconds (`experiments/second_order.py`); later steps go below it.

    Args:
        model: the initial model.
        objective: its limits are applied before each evaluation.
        start: a map near what `model` renders.
        steps: largest number of steps.
        scales: typical changes of Q, Z, R and xy, the units of the damping. If labels are already
            accurate, as in `ByEvidence`, use a hundredth of a pixel for Z.
        tolerance: tolerance of the linear systems.
        blunt: see `residuals_of`.
        progress: called after each step with its number and the loss.

    Returns:
        The best model seen. Not differentiable. Warns as `optimize` does.

    Raises:
        ValueError: `steps` is below 1.

    Source:
        In place of the gradient descent of Thesis 7.1.4.
    """
    if steps < 1:
        raise ValueError(f"`steps` must be at least 1, got {steps}.")
    warn_of_cuts(model, objective)
    dtype, origin = model.disparity.dtype, parts_of(model)
    units = jnp.asarray(scales, dtype)

    def unpack(change: tuple[Array, ...]) -> DepthModel:
        q, z, r, xy = (o + u * c for o, u, c in zip(origin, units, change, strict=True))
        return objective.project(with_parts(model, (q, z, r, xy)))

    # The loss is a mean; scaled to a sum, its curvature per parameter is about 1, as the initial
    # damping.
    whole = jnp.sqrt(jnp.asarray(start.size, dtype))

    def squared(change: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], Array]:
        residuals, disparity = residuals_of(objective, unpack(change), start, blunt=blunt)
        return tuple(whole * part for part in residuals), disparity

    @lean_jit
    def judged(change: tuple[Array, ...]) -> tuple[Array, Array]:
        return objective(unpack(change), start, key=jax.random.key(0))

    linear = lx.Normal(lx.CG(rtol=tolerance, atol=1e-8, max_steps=_LINEAR_STEPS))
    solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-8, linear_solver=linear)
    region = optx.ClassicalTrustRegion(high_cutoff=_GOOD)
    solver = eqx.tree_at(lambda s: s.search, solver, region)
    here: tuple[Array, ...] = tuple(jnp.zeros_like(part) for part in origin)
    fixed: dict[str, Any] = {"fn": squared, "args": None, "options": {"jac": "fwd"}}
    shapes = jax.eval_shape(squared, here, None)
    fixed["tags"] = frozenset()
    state = solver.init(y=here, f_struct=shapes[0], aux_struct=shapes[1], **fixed)
    step = lean_jit(lambda y, state: solver.step(y=y, state=state, **fixed))
    over = lean_jit(lambda y, state: solver.terminate(y=y, state=state, **fixed))
    loss, disparity = judged(here)
    losses, best = [loss], (here, disparity, loss)
    # The first step only evaluates the start, and is accepted.
    here, state, _ = step(here, state)
    for count in range(steps):
        here, state, _ = step(here, state)
        # Optimistix returns the previous iterate until a step is accepted.
        loss, disparity = judged(here)
        losses.append(loss)
        if loss < best[2]:
            best = (here, disparity, loss)
        if progress is not None:
            progress(count + 1, float(loss))
        if over(here, state)[0]:
            break
    return Minimized(unpack(best[0]), best[1], jnp.stack(losses))


def residuals_of(
    objective: Supervised | SelfSupervised,
    model: DepthModel,
    start: Float[Array, "y x"],
    *,
    blunt: float = 0.01,
) -> tuple[tuple[Array, ...], Float[Array, "y x"]]:
    """Residuals whose half sum of squares is a loss, smoothed at 0, and the map of the model.

    Args:
        objective: of the views, its gradient reward and dissimilarity, which are not squares, are
            left out, and all views count.
        model: of the points.
        start: a map near its rendering.
        blunt: absolute errors of a known map below this, px per view step, are squares; it should
            be below the expected errors.

    Returns:
        Residuals of the terms, and the map.
    """
    disparity = render_model(model, objective.renderer, start=start).disparity
    dtype = disparity.dtype
    prior, none = _of_prior(objective.trust, model), jnp.zeros((), dtype)
    if isinstance(objective, Supervised):
        known, weights = objective.known, cast(objective.weights, dtype)
        count = jnp.maximum(jnp.sum(known).astype(dtype), 1)
        error = jnp.where(known, disparity - jnp.where(known, objective.truth, 0), 0)
        error = _rooted(error, weights.absolute / count, weights.square / count, blunt)
        return (error, prior), disparity
    views, terms = objective.views, cast(objective.weights, dtype)
    visible = occlusion_masks(jax.lax.stop_gradient(disparity), views)
    warped = jax.vmap(objective.features)(warp_views(disparity, views, visible))
    away = warped - objective.features(views.center)
    count = jnp.maximum(jnp.sum(visible, axis=0).astype(dtype), 1)
    each = terms.reprojection / (count * disparity.size * away.shape[1])
    error = _rooted(away, jnp.where(visible, each, 0)[:, None], none, _BLUNT_FEATURE)
    slopes = _edge_aware_slopes(disparity, views.center)
    slope = _rooted(slopes, terms.smoothness / disparity.size, none, _BLUNT_SLOPE)
    return (error, slope, prior), disparity


def _of_prior(trust: Trust, model: DepthModel) -> Float[Array, "n"]:
    """Residuals whose half sum of squares is `Trust.penalty`."""
    trust = cast(trust, model.disparity.dtype)
    moved = (model.disparity - trust.origin.disparity) / jnp.maximum(trust.error, 1e-6)
    squared = jnp.maximum(jnp.where(model.valid, moved, 0) ** 2, jnp.asarray(1e-12, moved.dtype))
    count = jnp.maximum(jnp.sum(model.valid).astype(moved.dtype), 1)
    slope = safe_sqrt(2 * trust.weight * jnp.log1p(squared) / squared / count)
    return jnp.where(model.valid, moved * slope, 0)


def _rooted(error: Array, absolute: Array, square: Array, blunt: Array | float) -> Array:
    """Residual r with r²/2 = `absolute |error| + square error²`, smoothed at 0."""
    bent = jnp.sqrt(1 + (error / blunt) ** 2)
    return error * safe_sqrt(2 * (square + absolute / (blunt * (1 + bent))))
