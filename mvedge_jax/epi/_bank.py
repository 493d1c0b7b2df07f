"""Oriented Prewitt filters for epipolar-plane images, as explicit, learnable taps."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._crosshair import view_steps
from mvedge_jax._params import accepts_numpy


class FilterBank(eqx.Module):
    """One oriented step filter per disparity.

    A filter as tall as twice the EPI covers all of its rows wherever it is centered, so that every
    row of a line sees the same sum: the response depends on the line `(x_c, d)` alone, and the
    bank is a set of 1-D convolutions along x with the views as input channels.

    Attributes:
        disparity: disparity of each filter, px per view step, increasing.
        taps: weight of view `u` at offset `w - radius` px; correlation, not convolution. Any
            values will do: they are traced and may be learned.
    """

    disparity: Float[Array, " k"]
    taps: Float[Array, "k u w"]

    @property
    def radius(self) -> int:
        """How far the taps reach to either side, px."""
        return self.taps.shape[2] // 2


def bank_radius(reach: float, views: int) -> int:
    """Radius of the taps that holds lines of all disparities of a bank.

    Args:
        reach: largest disparity in magnitude, px per view step.
        views: number of views of the arm.

    Returns:
        Pixels to either side.
    """
    return math.ceil(abs(reach) * (views // 2)) + 2


def exponential_disparities(count: int, reach: float) -> Float[np.ndarray, " k"]:
    """Disparities that lie denser around zero.

    `d_j = reach (exp(-t_j) - exp(-1)) / (1 - exp(-1))` for `count // 2` values of `t` from 0 to 1,
    and their mirror images: `2 (count // 2) - 1` in all, since zero is its own.

    Args:
        count: nominal number of filters, at least 4; 60 in the thesis.
        reach: largest magnitude, px per view step.

    Returns:
        Increasing disparities (host array).

    Raises:
        ValueError: if there are fewer than 4 filters or the reach is not positive.

    Source: the authors' bank behind the "60 oriented Prewitt edge filters" of Thesis 4.1.1.

    Example:
        >>> exponential_disparities(60, 2.0).shape
        (59,)
    """
    if count < 4:
        raise ValueError(f"`count` must be at least 4, got {count}.")
    if not reach > 0:
        raise ValueError(f"`reach` must be positive, got {reach}.")
    t = np.linspace(0.0, 1.0, count // 2)
    half = reach * (np.exp(-t) - math.exp(-1)) / (1 - math.exp(-1))
    return np.concatenate([-half, half[-2::-1]])


def line_taps(
    disparity: Float[Array, " k"],
    views: int,
    radius: int,
    steps: Float[Array, " u"] | None = None,
) -> Float[Array, "k u w"]:
    """Taps that average the views along lines, split between the two nearest pixels of each row.

    Splitting along x in every row whatever the slope keeps the gain equal for all disparities;
    antialiased line drawing loses a quarter of it beyond 1 px per view. Taps are not negative and
    sum to 1. Differentiable in `disparity` and `steps`, piecewise.
    """
    if steps is None:
        steps = view_steps(views, disparity.dtype)
    position = disparity[:, None] * steps[None]
    offsets = jnp.asarray(np.arange(-radius, radius + 1), disparity.dtype)
    hat = 1 - jnp.abs(offsets[None, None] - position[..., None])
    return jnp.maximum(hat, 0) / views


@accepts_numpy
def prewitt_bank(
    disparity: Float[Array, " k"],
    views: int,
    radius: int,
    *,
    steps: Float[Array, " u"] | None = None,
) -> FilterBank:
    """The bank of oriented Prewitt filters: the average along the line at `x + 1` minus at `x - 1`.

    Args:
        disparity: px per view step of each filter.
        views: number of views of the arm, odd.
        radius: reach of the taps in px; `bank_radius` gives what the disparities need.
        steps: from the center view to each view, which disparity is multiplied by, for views that
            are not evenly spaced; taps beyond the radius are cut off.

    Returns:
        The bank; a unit step of intensity answers with 1. Differentiable in `disparity` and
        `steps`.

    Source: Thesis 4.1.1 and Alg. 1.

    Example:
        >>> import jax.numpy as jnp
        >>> bank = prewitt_bank(jnp.array([-0.5, 0.0, 0.5]), views=5, radius=bank_radius(0.5, 5))
        >>> bank.taps.shape
        (3, 5, 7)
    """
    line = line_taps(disparity, views, radius, steps)
    ahead = jnp.pad(line[..., :-1], ((0, 0), (0, 0), (1, 0)))
    behind = jnp.pad(line[..., 1:], ((0, 0), (0, 0), (0, 1)))
    return FilterBank(disparity, ahead - behind)
