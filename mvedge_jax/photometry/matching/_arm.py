"""The cost of a disparity along one arm, over the half of its views that agrees better."""

from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import no_fuse, plane_sum, unstack
from mvedge_jax._crosshair import Arm
from mvedge_jax.interpolation import keys_taps

from .._window import color_weights, weighted_sum

# First row and column of a part of an image.
Corner = tuple[Array | int, Array | int]


class Half(NamedTuple):
    """The views on one side of the center view that a sweep compares.

    Attributes:
        planes: colors, padded along the arm by its length, `[s, c, y, x]`.
        steps: view steps from the center view.
        there: 1 for available views, 0 for others.
    """

    planes: Array
    steps: Array
    there: Array


class Swept(NamedTuple):
    """An arm prepared for a sweep.

    Attributes:
        center: colors of the center view, `[c, y, x]`.
        halves: the other views.
        support: window weights of the cost.
        wide: window weights of the drift: a window twice as wide with as many pixels.
        share: how much of the drift is granted.
    """

    center: Array
    halves: tuple[Half, Half]
    support: Array
    wide: Array
    share: Array


class Limits(NamedTuple):
    """The numbers of a cost.

    Attributes:
        truncation: squared differences of color that count half.
        drift: largest change of color that is taken out.
        alpha: dominance of the noise.
    """

    truncation: Array
    drift: Array
    alpha: Array


def swept(arm: Arm, lab: Array, share: Array, same_color: Array, window: int) -> Swept:
    """Prepares an arm.

    Args:
        arm: low-passed.
        lab: the center view in CIELAB, in the arm's orientation.
        share: how much of the drift is granted, likewise.
        same_color: see `Matching`.
        window: half the width of the window, px.
    """
    return Swept(
        arm.planes[arm.center],
        halves_of(arm),
        color_weights(lab, same_color, reach=window),
        color_weights(lab, same_color, reach=window, spacing=2),
        share,
    )


def arm_cost(arm: Swept, disparity: Float[Array, ""], limits: Limits) -> Float[Array, "y x"]:
    """Cost of the half that agrees better, in units of the truncation.

    Args:
        arm: prepared.
        disparity: px per view step.
        limits: see `Limits`.
    """
    size = arm.center.shape[1], arm.center.shape[2]

    def moved(half: Half, center: Array, disparity: Array) -> list[Array]:
        return _changes(shifted(half, disparity, (0, 0), size), half.steps, center, disparity)

    # Stored, because both the drift and the cost read them.
    changes = [no_fuse(moved, half, arm.center, disparity) for half in arm.halves]
    return _better_half(arm, changes, limits)


def moved_cost(
    arm: Swept, moved: list[list[Array]], disparity: Float[Array, ""], limits: Limits
) -> Float[Array, "y x"]:
    """`arm_cost` of a part of the image whose views are already shifted.

    Args:
        arm: the arm cut to the part; its planes are not read.
        moved: per half and view, see `shifted`.
        disparity: px per view step.
        limits: see `Limits`.
    """
    changes = [
        no_fuse(_changes, parts, half.steps, arm.center, disparity)
        for parts, half in zip(moved, arm.halves, strict=True)
    ]
    return _better_half(arm, changes, limits)


def reach_of(window: int) -> int:
    """Radius of the center view's pixels that a cost reads, px.

    Args:
        window: half the width of the window of the cost; that of the drift is twice as wide.
    """
    return 3 * window


def _better_half(arm: Swept, changes: list[list[Array]], limits: Limits) -> Array:
    drifts = arm.share[None] * _drift(arm.halves, changes, arm.wide, limits.drift)

    def cost(half: Half, changes: list[Array], drift: Array) -> Array:
        total = jnp.zeros_like(drift)
        for change, step, there in _per_view(half, changes):
            total = total + there * truncated(change - step * drift[None], limits.truncation)
        count = jnp.sum(half.there)
        # A half without views gets the largest cost.
        return jnp.where(count > 0, total / jnp.maximum(count, 1), 1)

    means = jnp.stack([cost(*of) for of in zip(arm.halves, changes, unstack(drifts), strict=True)])
    first, second = unstack(weighted_sum(means, arm.support))
    return _better(first, second, limits.alpha)


def shifted(half: Half, disparity: Array, corner: Corner, size: tuple[int, int]) -> list[Array]:
    """Pixels of every view of a half that a disparity moves to a part of the center view.

    Args:
        half: with padded planes.
        disparity: px per view step.
        corner: first row and column of the part.
        size: rows and columns of it.

    Returns:
        Colors of each view, `[c, y, x + 3]`: four taps lie around every pixel.
    """
    views, colors = half.planes.shape[:2]
    places = [shifted_to(half, disparity, s, corner) for s in range(views)]
    return [
        lax.dynamic_slice(planes, place, (colors, size[0], size[1] + 3))
        for planes, (_, *place) in zip(unstack(half.planes), places, strict=True)
    ]


def shifted_to(half: Half, disparity: Array, view: int, corner: Corner) -> list[Array]:
    """Corner, in the planes of a half, of the part that `shifted` reads of a view."""
    width = (half.planes.shape[3] - 3) // 3
    whole = jnp.floor(half.steps[view] * disparity).astype(jnp.int32)
    first = jnp.clip(whole, -width, width) + width - 1 + corner[1]
    return [jnp.asarray(at, jnp.int32) for at in (view, 0, corner[0], first)]


def _changes(moved: list[Array], steps: Array, center: Array, disparity: Array) -> list[Array]:
    """Colors of every view of a half at a disparity minus those of the center view."""
    width = center.shape[2]
    result = []
    for part, step in zip(moved, unstack(steps), strict=True):
        shift = step * disparity
        weights = keys_taps(shift - jnp.floor(shift))
        seen = sum(w * part[..., j : j + width] for j, w in enumerate(weights))
        result.append(seen - center)
    return result


def _better(first: Array, second: Array, alpha: Array) -> Array:
    """Minimum of two costs; under noise a soft one, as the minimum is biased low."""
    scale = 0.05 * jnp.where(alpha > 0, alpha, 1)

    def soft(first: Array, second: Array) -> Array:
        return jnp.minimum(first, second) - scale * jnp.log(
            0.5 * (1 + jnp.exp(-jnp.abs(first - second) / scale))
        )

    return lax.cond(alpha > 0, soft, jnp.minimum, first, second)


def _drift(
    halves: tuple[Half, Half], changes: list[list[Array]], weights: Array, limit: Array
) -> Float[Array, "h y x"]:
    """Change of a window's gray value per view step, by regression through the center view."""
    ends = [jnp.max(jnp.abs(half.steps), initial=1) for half in halves]

    def trend(half: Half, changes: list[Array], last: Array) -> Array:
        total, square = jnp.zeros_like(weights[0]), jnp.zeros_like(last)
        for change, step, there in _per_view(half, changes):
            gray = plane_sum(change) / change.shape[0]
            # Changes far beyond any drift belong to another surface and are ignored.
            total = total + there * step * jnp.clip(gray, -3 * limit, 3 * limit)
            square = square + there * step**2
        return total * (last / jnp.maximum(square, 1))

    trends = jnp.stack([trend(*of) for of in zip(halves, changes, ends, strict=True)])
    change = weighted_sum(trends, weights, spacing=2)
    return jnp.clip(change, -limit, limit) / jnp.stack(ends)[:, None, None]


def truncated(change: Float[Array, "c y x"], truncation: Array) -> Float[Array, "y x"]:
    """Saturated squares of a change: one half at `truncation`."""
    square = plane_sum(change**2)
    return square / (square + truncation)


def _per_view(half: Half, changes: list[Array]) -> Iterator[tuple[Array, Array, Array]]:
    """Every view's change, step and availability."""
    return zip(changes, unstack(half.steps), unstack(half.there), strict=True)


def halves_of(arm: Arm) -> tuple[Half, Half]:
    """The views of an arm that a sweep compares, on either side of the center view."""
    width = arm.planes.shape[3]
    indices = sweep_views(arm.planes.shape[0])

    def half(views: list[int]) -> Half:
        chosen = np.asarray(views, int)
        padding = ((0, 0), (0, 0), (0, 0), (width, width + 3))
        planes = jnp.pad(arm.planes[chosen], padding, mode="edge")
        return Half(planes, arm.steps[chosen], arm.available[chosen].astype(planes.dtype))

    before = half([i for i in indices if i < arm.center])
    return before, half([i for i in indices if i > arm.center])


def sweep_views(count: int) -> tuple[int, ...]:
    """Views of an arm that a sweep compares: the ends, and those half-way to them."""
    center = count // 2
    near = center // 2
    picked = {0, center - near, center + near, count - 1} - {center}
    return tuple(sorted(picked))
