"""Consistency of the views' maps by the equations as the thesis prints them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax.metrics import ViewConsistency
from mvedge_jax.metrics._consistency import average_over_views, check_views
from mvedge_jax.metrics._region import cropped
from mvedge_jax.warping import landing, z_buffer


@accepts_numpy
def printed_view_consistency(
    disparities: Float[Array, "v u y x"],
    *,
    available: Bool[Array, "v u"] | None = None,
    crop: int = 0,
) -> ViewConsistency:
    r"""Eq. 6.9 and 6.10 as the thesis prints them, for comparison with its figures.

    All maps are warped forward onto the target view, nearest pixel and nearest surface, and
    $\rho_0, \dots, \rho_n$ is what lands on a pixel s, the target's own map included:

    $$C(s) = \frac{1}{n} \sum_{i=0}^n (\rho_i(s) - \mu_s)^2, \quad
    \mu_s = \frac{1}{n} \sum_{i=0}^n \rho_i(s), \quad C = \frac{1}{|S|} \sum_{s \in S} C(s).$$

    It differs from `view_consistency` in three ways. The n + 1 terms are divided by n, which adds
    $m^2 (n + 1) / n^3$ of the mean m: about m²/n², so that the score depends on which surface has
    disparity 0. Surfaces that one view shows and another does not are compared with each other, so
    that true maps do not score 0. A slanted surface is charged for the rounding to whole pixels.
    The thesis does not say what holes count: a map with a hole at s has no say there, and n is the
    number of the others without one.

    Args:
        disparities: One map per view, each on its own pixels, `[v, u, y, x]`, px per view step.
        available: Views that take part, `[v, u]`; all by default.
        crop: Pixels to leave out on each side of the target, static.

    Returns:
        The scores, over pixels where two maps or more land. If a map that takes part is not finite
        somewhere, every score is infinite. Work grows with the square of the number of views.
        Not differentiable with respect to where a pixel lands.

    Raises:
        ValueError: if the shapes do not fit together or the crop leaves nothing.

    Source: Thesis 6.2.3, Eq. 6.9 and 6.10.

    Example:
        >>> import jax.numpy as jnp
        >>> printed_view_consistency(jnp.zeros((3, 3, 8, 8))).mean.item()
        0.0
    """
    available = check_views(disparities, available, crop)
    return _printed_per_view(disparities, available, crop=crop)


@partial(jax.jit, static_argnames="crop")
def _printed_per_view(disparities, available, *, crop) -> ViewConsistency:
    def score(view: Array) -> tuple[Array, Array]:
        variance, count = _printed_map(disparities, view, available)
        return cropped(variance, crop), cropped(count, crop)

    return average_over_views(score, disparities, available)


def _printed_map(disparities, view, available) -> tuple[Array, Array]:
    """(6.9) of one view, and the number of maps that land on each of its pixels."""
    rows, columns, height, width = disparities.shape
    dtype = disparities.dtype
    grid = np.indices((rows, columns)).reshape(2, -1).T

    def add(state: tuple[Array, Array, Array], item: tuple[Array, ...]):
        count, mean, squares = state
        disparity, source, use = item
        # From map i to the target: (u_i - u, v_i - v) steps.
        index, stays = landing(disparity, (source - view)[::-1].astype(dtype))
        nearest = z_buffer(jnp.where(stays, disparity, -jnp.inf), index)[:-1]
        nearest = nearest.reshape(height, width)
        lands = use & jnp.isfinite(nearest)
        value = jnp.where(lands, nearest, mean)
        count = count + lands.astype(count.dtype)
        delta = value - mean
        mean = mean + delta / jnp.maximum(count, 1).astype(dtype)
        return (count, mean, squares + delta * (value - mean)), None

    empty = jnp.zeros((height, width), dtype)
    items = (disparities.reshape(-1, height, width), jnp.asarray(grid, jnp.int32))
    start = (empty.astype(jnp.int32), empty, empty)
    (count, mean, squares), _ = lax.scan(add, start, (*items, available.ravel()))
    terms = count.astype(dtype)
    n = jnp.maximum(terms - 1, 1)
    # The printed mean is (n + 1) / n of the mean, so every term is off by mean / n.
    return (squares + terms * (mean / n) ** 2) / n, count
