"""The cost of a disparity over views at any positions, over the half that agrees better."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import plane_sum, unstack

from .._window import weighted_sum
from ..views import ViewSet
from ._agreement import Agreement, Window
from ._arm import Limits, truncated


def stack_costs(
    views: ViewSet,
    disparities: Float[Array, " d"],
    weights: tuple[Float[Array, "o y x"], Float[Array, "o y x"]],
    share: Float[Array, "y x"],
    limits: Limits,
    variance: Float[Array, ""],
    agreement: Agreement | None,
) -> Float[Array, "d y x"]:
    """The costs of all disparities, as `volume` has those of two arms.

    An occluder usually hides a pixel on one side, so only the better half of all views counts: its
    mean of truncated squared color differences over a color-weighted window. A change of the
    window's mean color is removed first, up to limits that grow with the distance from the
    reference. A view has the largest cost if the pixel is outside of its frame or behind its
    camera. With an `agreement`, the correlation of the window counts too, and a soft minimum over
    the views replaces their better half.

    Args:
        views: views after gains, low-passed.
        disparities: hypotheses, px.
        weights: window weights of the cost and of the drift, see `Swept`.
        share: share of the drift that is allowed.
        limits: see `Limits`.
        variance: of the noise, the unit of `Agreement.contrast`.
        agreement: see `Agreement`; None for the better half and for colors alone.

    Returns:
        Costs, at most 2. Differentiable.
    """
    support, wide = weights
    reference, shape = views.center, views.planes.shape[2:]
    window = None
    if agreement is not None:
        floor = agreement.contrast * reference.shape[0] * variance
        window = Window.of(reference, support, floor)
    own = None if views.shown is None else views.shown[0]
    others = views.mapped(lambda planes: jnp.moveaxis(planes, 1, -1)).others
    apart = others.parallax.apart
    most = limits.drift * apart / jnp.max(apart)

    @jax.checkpoint
    def cost(disparity: Array) -> Array:
        everywhere = jnp.full(shape, disparity)

        def one(item: tuple[ViewSet, Array]) -> Array:
            view, limit = item
            x, y = view.parallax.positions(everywhere)
            there = view.readable(x, y, shape, own)
            seen = jnp.stack(linear(view.planes, x, y))
            change = seen - reference
            gray = plane_sum(change) / change.shape[0]
            # Changes far beyond any drift belong to another surface and are ignored.
            gray = jnp.where(there, jnp.clip(gray, -3 * limit, 3 * limit), 0)
            drift = weighted_sum(gray[None], wide, spacing=2)[0]
            drift = share * jnp.clip(drift, -limit, limit)
            differs = jnp.where(there, truncated(change - drift[None], limits.truncation), 1)
            if agreement is None or window is None:
                return differs
            if view.shown is not None:
                # The colors of transparent pixels have no say in the windows of others.
                seen = jnp.where(there[None], seen, window.mean)
            unlike = jnp.where(there, window.unlike(seen), 1)
            differs = weighted_sum(differs[None], support)[0]
            return differs + agreement.correlation * (unlike - differs)

        costs = lax.map(one, (others, most))
        if agreement is None:
            return 2 * better_half(weighted_sum(costs, support))
        return 2 * agreement.pooled(costs)

    return lax.map(cost, disparities)


def better_half(costs: Float[Array, "s y x"]) -> Float[Array, "y x"]:
    """Mean of the smaller half of the costs, by exchanges, which XLA on CPU vectorizes."""
    planes = unstack(costs)
    kept = (len(planes) + 1) // 2
    for first in range(kept):
        for other in range(first + 1, len(planes)):
            low = jnp.minimum(planes[first], planes[other])
            planes[other] = jnp.maximum(planes[first], planes[other])
            planes[first] = low
    return sum(planes[1:kept], planes[0]) / kept


def linear(image: Float[Array, "y x c"], x: Array, y: Array) -> list[Array]:
    """Colors between pixels, by linear interpolation; the border is repeated."""
    height, width, channels = image.shape
    x, y = jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)
    column = jnp.minimum(jnp.floor(x), width - 2).astype(jnp.int32)
    row = jnp.minimum(jnp.floor(y), height - 2).astype(jnp.int32)
    right, down = x - column.astype(x.dtype), y - row.astype(y.dtype)
    first = (row * width + column) * channels
    # Both pixels of a row and their channels lie side by side: one gather for all of them.
    slices = lax.GatherDimensionNumbers(
        offset_dims=(2,), collapsed_slice_dims=(), start_index_map=(0,)
    )
    flat, result = image.reshape(-1), []
    upper, lower = (
        lax.gather(flat, start[..., None], slices, (2 * channels,), mode="promise_in_bounds")
        for start in (first, first + width * channels)
    )
    for c in range(channels):
        above = upper[..., c] + right * (upper[..., c + channels] - upper[..., c])
        below = lower[..., c] + right * (lower[..., c + channels] - lower[..., c])
        result.append(above + down * (below - above))
    return result
