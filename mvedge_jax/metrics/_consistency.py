"""How well the disparity maps of all views agree (Thesis 6.2.3, Eq. 6.9 and 6.10, Fig. 6.5)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax.warping import landing, z_buffer

from ._region import cropped


class ViewConsistency(NamedTuple):
    """Disagreement between the views' disparity maps; see `view_consistency`.

    Attributes:
        per_view: Eq. 6.10 in every view, `[v, u]`, px²; NaN where a view is missing.
        covered: Share of each view's pixels that two maps or more reach, `[v, u]`: the scores are
            over these pixels only.
        mean: Mean of `per_view` over the views there are, px².
    """

    per_view: Float[Array, "v u"]
    covered: Float[Array, "v u"]
    mean: Float[Array, ""]


def _check(disparities: Array, available: Array | None, crop: int) -> Array:
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
    if not 0 <= 2 * crop < min(disparities.shape[2:]):
        raise ValueError(
            f"`crop` must be at least 0 and leave pixels of maps of "
            f"{disparities.shape[2]}x{disparities.shape[3]}, got {crop}."
        )
    return jnp.ones(disparities.shape[:2], bool) if available is None else available


def view_consistency(
    disparities: Float[Array, "v u y x"],
    *,
    available: Bool[Array, "v u"] | None = None,
    crop: int = 0,
) -> ViewConsistency:
    r"""Variance between the disparity maps of all views, in every view.

    For a target view the maps of all views (its own included) are moved to it: every pixel goes to
    the nearest pixel of the target, the nearest surface wins. With $\rho_i(s)$ the value of
    map i at pixel s, for the $n_s$ maps that have one there,

    $$C(s) = \frac{1}{n_s} \sum_i (\rho_i(s) - \mu_s)^2, \quad \mu_s = \frac{1}{n_s} \sum_i
    \rho_i(s), \quad C = \frac{1}{|S|} \sum_{s \in S} C(s),$$

    where S are the pixels with $n_s \ge 2$. The printed equations divide n + 1 terms by n. Because
    pixels are moved to whole pixels, a perfect set of maps of a surface whose disparity changes by
    g px per px scores up to $g^2 / 4$, not 0.

    Args:
        disparities: One map per view, each on its own pixels, `[v, u, y, x]`, px per view step.
        available: Views that take part, `[v, u]`; all by default.
        crop: Pixels to leave out on each side of the target, static.

    Returns:
        The disagreement per view and its mean. If a map that takes part is not finite somewhere,
        every score is infinite: gaps are not rewarded. Not differentiable with respect to which
        pixel goes where.

    Raises:
        ValueError: if the shapes do not fit together or the crop leaves nothing.

    Source: Thesis 6.2.3, Eq. 6.9 and 6.10 with the normalisation corrected, see the
        documentation's page of equations.

    Example:
        >>> import jax.numpy as jnp
        >>> view_consistency(jnp.ones((3, 3, 8, 8))).mean.item()
        0.0
    """
    return _per_view(disparities, _check(disparities, available, crop), crop=crop)


def view_consistency_map(
    disparities: Float[Array, "v u y x"],
    view: tuple[int, int] | Int[Array, "2"],
    *,
    available: Bool[Array, "v u"] | None = None,
) -> tuple[Float[Array, "y x"], Int[Array, "y x"]]:
    """Variance between the disparity maps of all views, per pixel of one view.

    Args:
        disparities: One map per view, each on its own pixels, `[v, u, y, x]`, px per view step.
        view: The target `(v, u)`, traced.
        available: Views that take part, `[v, u]`; all by default.

    Returns:
        The variance, `[y, x]`, px², and the number of maps that have a value there, `[y, x]`. A
        pixel that is not finite in its own map is infinite; in other maps it is a hole.

    Raises:
        ValueError: if the shapes do not fit together.

    Source: Thesis 6.2.3, Eq. 6.9.
    """
    available = _check(disparities, available, 0)
    return _map(disparities, jnp.asarray(view, jnp.int32), available)


@jax.jit
def _map(disparities, view, available) -> tuple[Array, Array]:
    rows, columns, *shape = disparities.shape
    dtype = disparities.dtype
    grid = np.indices((rows, columns)).reshape(2, -1).T
    maps = disparities.reshape(-1, *shape)
    own = disparities[view[0], view[1]]

    def add(state: tuple[Array, Array, Array], item: tuple[Array, Array, Array]):
        count, mean, squares = state
        disparity, source, use = item
        # From view i to the target: (u_i - u, v_i - v) steps.
        step = (source - view)[::-1].astype(dtype)
        index, stays = landing(disparity, step)
        moved = z_buffer(jnp.where(stays, disparity, -jnp.inf), index)[:-1].reshape(shape)
        hit = use & jnp.isfinite(moved)
        value = jnp.where(hit, moved, mean)
        count = count + hit.astype(count.dtype)
        delta = value - mean
        mean = mean + delta / jnp.maximum(count, 1).astype(dtype)
        return (count, mean, squares + delta * (value - mean)), None

    start = (jnp.zeros(own.shape, jnp.int32), jnp.zeros_like(own), jnp.zeros_like(own))
    items = (maps, jnp.asarray(grid, jnp.int32), available.ravel())
    (count, _, squares), _ = jax.lax.scan(add, start, items)
    variance = squares / jnp.maximum(count, 1).astype(dtype)
    return jnp.where(jnp.isfinite(own), variance, jnp.inf), count


def _all_views(disparities, available, *, crop) -> ViewConsistency:
    rows, columns = available.shape
    grid = np.indices((rows, columns)).reshape(2, -1).T

    def score(view: Array) -> tuple[Array, Array]:
        variance, count = (cropped(a, crop) for a in _map(disparities, view, available))
        shared = count >= 2
        total = jnp.where(shared, variance, 0).sum(1).sum()
        number = shared.sum(dtype=jnp.int32).astype(total.dtype)
        mean = jnp.where(number > 0, total / jnp.maximum(number, 1), jnp.nan)
        return mean, number / shared.size

    scores = jax.lax.map(score, jnp.asarray(grid, jnp.int32))
    per_view, covered = (a.reshape(rows, columns) for a in scores)
    complete = jnp.isfinite(disparities).all((2, 3)) | ~available
    per_view = jnp.where(complete.all(), per_view, jnp.inf)
    per_view = jnp.where(available, per_view, jnp.nan)
    return ViewConsistency(per_view, covered, jnp.nanmean(per_view))


_per_view = jax.jit(_all_views, static_argnames=("crop",))
