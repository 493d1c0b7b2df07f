"""How well the disparity maps of all views agree (Thesis 6.2.3, Eq. 6.9 and 6.10, Fig. 6.5)."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy

from ._region import check_crop, cropped

# Positions that rounding leaves this far below a whole pixel are that pixel, px.
_SLACK = 1e-3


class ViewConsistency(NamedTuple):
    """Disagreement between the views' disparity maps; see `view_consistency`.

    Attributes:
        per_view: Eq. 6.10 in every view, `[v, u]`, px²; NaN where a view is missing.
        covered: Share of each view's pixels that two views or more see, `[v, u]`: the scores are
            over these pixels only.
        mean: Mean of `per_view` over the views there are, px².
    """

    per_view: Float[Array, "v u"]
    covered: Float[Array, "v u"]
    mean: Float[Array, ""]


def check_views(disparities: Array, available: Array | None, crop: int) -> Array:
    if disparities.ndim != 4:
        raise ValueError(
            f"`disparities` must have the axes [v, u, y, x], one map per view, got shape "
            f"{disparities.shape}."
        )
    if available is not None and available.shape != disparities.shape[:2]:
        raise ValueError(
            f"`available` must have the shape of the view grid {disparities.shape[:2]}, got "
            f"{available.shape}."
        )
    check_crop(disparities.shape[2:], crop)
    return jnp.ones(disparities.shape[:2], bool) if available is None else available


@accepts_numpy
def view_consistency(
    disparities: Float[Array, "v u y x"],
    *,
    available: Bool[Array, "v u"] | None = None,
    crop: int = 0,
    stride: int = 3,
    tolerance: Float[Array, ""] | float = 0.1,
) -> ViewConsistency:
    r"""Variance between the disparity maps of all views, in every view, where they see the same.

    A pixel s of a target view lies, by its own disparity d, between four pixels of every other
    view. $\rho_i(s)$ is what map i says there: the value nearest to d in the range of those four
    pixels, so that whole pixels on slanted surfaces and beside steps cost nothing. Where all four
    are nearer than d by more than the tolerance, view i does not see the point and has no say: a
    map that is too near is charged in its own view, where the others show what is behind it. Over
    the $n_s$ maps that have one, the target's own included,

    $$C(s) = \frac{1}{n_s} \sum_i (\rho_i(s) - \mu_s)^2, \quad \mu_s = \frac{1}{n_s} \sum_i
    \rho_i(s), \quad C = \frac{1}{|S|} \sum_{s \in S} C(s),$$

    where S are the pixels with $n_s \ge 2$. True maps score about 0, but so does one constant: read
    it beside the error of the maps.

    Args:
        disparities: One map per view, each on its own pixels, `[v, u, y, x]`, px per view step.
        available: Views that take part, `[v, u]`; all by default.
        crop: Pixels to leave out on each side of the target, static.
        stride: Every which pixel of the target is scored, along either axis, static.
        tolerance: How much nearer another surface must be to hide a pixel, px per view step.

    Returns:
        The disagreement per view and its mean. If a map that takes part is not finite somewhere,
        every score is infinite: gaps are not rewarded. Not differentiable with respect to where
        a pixel lies in other views.

    Raises:
        ValueError: if shapes do not fit, the crop leaves nothing or the stride is below 1.

    Source: Thesis 6.2.3, Eq. 6.9 and 6.10 with the normalization corrected.

    Example:
        >>> import jax.numpy as jnp
        >>> view_consistency(jnp.ones((3, 3, 8, 8))).mean.item()
        0.0
    """
    available = check_views(disparities, available, crop)
    if stride < 1:
        raise ValueError(f"`stride` must be at least 1, got {stride}.")
    limit = jnp.asarray(tolerance, disparities.dtype)
    return _per_view(disparities, available, limit, crop=crop, stride=stride)


@accepts_numpy
def view_consistency_map(
    disparities: Float[Array, "v u y x"],
    view: tuple[int, int] | Int[Array, "2"],
    *,
    available: Bool[Array, "v u"] | None = None,
    tolerance: Float[Array, ""] | float = 0.1,
) -> tuple[Float[Array, "y x"], Int[Array, "y x"]]:
    """Variance between the disparity maps of all views that see each pixel of one view.

    Args:
        disparities: One map per view, each on its own pixels, `[v, u, y, x]`, px per view step.
        view: The target `(v, u)`, traced.
        available: Views that take part, `[v, u]`; all by default.
        tolerance: How much nearer another surface must be to hide a pixel, px per view step.

    Returns:
        The variance, `[y, x]`, px², and the number of maps that see the pixel, `[y, x]`. A pixel
        that is not finite in its own map is infinite; in other maps it is a hole.

    Raises:
        ValueError: if shapes do not fit, or the view, unless traced, is not one of the grid.

    Source: Thesis 6.2.3, Eq. 6.9.
    """
    available = check_views(disparities, available, 0)
    if not isinstance(view, Tracer):
        v, u = (int(index) for index in view)
        rows, columns = disparities.shape[:2]
        if not (0 <= v < rows and 0 <= u < columns):
            raise ValueError(f"`view` must be one of the {rows}x{columns} views, got ({v}, {u}).")
    limit = jnp.asarray(tolerance, disparities.dtype)
    low, high = _ranges(disparities)
    own = jnp.asarray(view, jnp.int32)
    return _map(disparities, low, high, own, available, limit, crop=0, stride=1)


@jax.jit
def _ranges(disparities: Array) -> tuple[Array, Array]:
    """Least and largest of every 2x2 pixels, those beyond the border as those at it."""

    def of(operation: Callable[[Array, Array], Array]) -> Array:
        values = disparities
        for axis in (2, 3):
            last = lax.slice_in_dim(values, -1, None, axis=axis)
            rest = lax.slice_in_dim(values, 1, None, axis=axis)
            values = operation(values, jnp.concatenate([rest, last], axis=axis))
        return values

    return of(jnp.minimum), of(jnp.maximum)


@partial(jax.jit, static_argnames=("crop", "stride"))
def _map(disparities, low, high, view, available, limit, *, crop, stride) -> tuple[Array, Array]:
    rows, columns, height, width = disparities.shape
    dtype = disparities.dtype
    grid = np.indices((rows, columns)).reshape(2, -1).T
    target = cropped(disparities[view[0], view[1]], crop)[::stride, ::stride]
    x = jnp.arange(crop, width - crop, stride, dtype=dtype)[None]
    y = jnp.arange(crop, height - crop, stride, dtype=dtype)[:, None]
    own = jnp.where(jnp.isfinite(target), target, 0)

    def add(state: tuple[Array, Array, Array], item: tuple[Array, ...]):
        count, mean, squares = state
        least, most, source, use = item
        # From the target to view i: (u - u_i, v - v_i) steps.
        step = (view - source)[::-1].astype(dtype)
        column, row = jnp.floor(x + step[0] * own + _SLACK), jnp.floor(y + step[1] * own + _SLACK)
        inside = (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
        index = jnp.where(inside, row.astype(jnp.int32) * width + column.astype(jnp.int32), 0)
        near, far = (a.ravel().at[index].get(mode="promise_in_bounds") for a in (most, least))
        seen = use & inside & jnp.isfinite(near) & jnp.isfinite(far) & (far <= own + limit)
        value = jnp.where(seen, jnp.clip(own, far, near), mean)
        count = count + seen.astype(count.dtype)
        delta = value - mean
        mean = mean + delta / jnp.maximum(count, 1).astype(dtype)
        return (count, mean, squares + delta * (value - mean)), None

    start = (jnp.zeros(own.shape, jnp.int32), jnp.zeros_like(own), jnp.zeros_like(own))
    each = (a.reshape(-1, height, width) for a in (low, high))
    items = (*each, jnp.asarray(grid, jnp.int32), available.ravel())
    (count, _, squares), _ = lax.scan(add, start, items)
    variance = squares / jnp.maximum(count, 1).astype(dtype)
    return jnp.where(jnp.isfinite(target), variance, jnp.inf), count


def _all_views(disparities, available, limit, *, crop, stride) -> ViewConsistency:
    low, high = _ranges(disparities)

    def score(view: Array) -> tuple[Array, Array]:
        return _map(disparities, low, high, view, available, limit, crop=crop, stride=stride)

    return average_over_views(score, disparities, available)


def average_over_views(
    score: Callable[[Array], tuple[Array, Array]], disparities: Array, available: Array
) -> ViewConsistency:
    """(6.10) in every view, of what `score` says of a view's pixels and of how many maps."""
    rows, columns = available.shape
    grid = np.indices((rows, columns)).reshape(2, -1).T

    def average(view: Array) -> tuple[Array, Array]:
        variance, count = score(view)
        shared = count >= 2
        total = jnp.where(shared, variance, 0).sum(1).sum()
        number = shared.sum(dtype=jnp.int32).astype(total.dtype)
        mean = jnp.where(number > 0, total / jnp.maximum(number, 1), jnp.nan)
        return mean, number / shared.size

    scores = lax.map(average, jnp.asarray(grid, jnp.int32))
    per_view, covered = (a.reshape(rows, columns) for a in scores)
    complete = jnp.isfinite(disparities).all((2, 3)) | ~available
    per_view = jnp.where(complete.all(), per_view, jnp.inf)
    per_view = jnp.where(available, per_view, jnp.nan)
    return ViewConsistency(per_view, covered, jnp.nanmean(per_view))


_per_view = jax.jit(_all_views, static_argnames=("crop", "stride"))
