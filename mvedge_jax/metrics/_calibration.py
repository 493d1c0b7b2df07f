"""Whether standard errors are true: coverage, reliability, sparsification."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from ._region import check_maps, counted_pixels, cropped

_MULTIPLES = (1.0, 2.0, 3.0)


class Calibration(NamedTuple):
    """How standard errors compare with errors.

    Attributes:
        within: share of the pixels whose error is at most 1, 2, 3 standard errors; of a normal
            distribution .683, .954, .997.
        predicted: median standard error of groups of equally many pixels, px, ascending.
        found: error that 68.3 % of every group do not exceed, px: equal to `predicted` if errors
            are normal and their standard errors true.
        left_out: shares of the pixels that are left out, from 0.
        sparsified: mean absolute error of the rest, the least certain pixels left out first, over
            that of all.
        oracle: the same, the largest errors left out first.
        ause: area between the two curves; 0 is an order that is as good as knowing the truth.
    """

    within: Float[np.ndarray, "3"]
    predicted: Float[np.ndarray, " g"]
    found: Float[np.ndarray, " g"]
    left_out: Float[np.ndarray, " f"]
    sparsified: Float[np.ndarray, " f"]
    oracle: Float[np.ndarray, " f"]
    ause: float


def calibration(
    disparity: Float[Array, "y x"],
    error: Float[Array, "_ _"],
    truth: Float[Array, "y x"],
    *,
    mask: Bool[Array, "y x"] | None = None,
    crop: int = 0,
    groups: int = 20,
) -> Calibration:
    """Compares the standard errors of a map with its errors.

    Computed on the host, in float64: not differentiable, and not for use under `jit`.

    Args:
        disparity: the map, `[y, x]`, px per view step.
        error: its standard error, `[y, x]`, px; positive, infinite where nothing is known.
        truth: ground truth, `[y, x]`, px per view step; NaN where unknown.
        mask: pixels that count, `[y, x]`; all by default.
        crop: pixels to leave out on each side.
        groups: of pixels of like standard error, and shares that are left out.

    Returns:
        See `Calibration`; NaN, and no groups, if no pixel counts.

    Raises:
        ValueError: shapes differ, or `groups`, `disparity` or `error` are out of range.

    Source: sparsification as in Ilg et al. 2018; not in the thesis.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> noise = jax.random.normal(jax.random.key(0), (200, 200))
        >>> found = calibration(0.1 * noise, jnp.full((200, 200), 0.1), jnp.zeros((200, 200)))
        >>> found.within.round(2).tolist()
        [0.68, 0.95, 1.0]
    """
    check_maps(disparity, truth, mask, crop)
    if error.shape != disparity.shape:
        raise ValueError(
            f"`error` must have the shape of `disparity`, {disparity.shape}, got {error.shape}."
        )
    counted = np.asarray(cropped(counted_pixels(truth, mask), crop))

    def kept(values: Array) -> np.ndarray:
        return np.asarray(cropped(values, crop), np.float64)[counted]

    size, sigma = np.abs(kept(disparity) - kept(truth)), kept(error)
    count = size.size
    if groups < 1:
        raise ValueError(f"`groups` must be at least 1, got {groups}.")
    if count == 0:
        none = np.zeros(0)
        return Calibration(np.full(len(_MULTIPLES), np.nan), none, none, none, none, none, np.nan)
    groups = min(groups, count)
    if not np.isfinite(size).all():
        raise ValueError(
            f"`disparity` must be finite; {int((~np.isfinite(size)).sum())} of {count} pixels that "
            "count are infinite or NaN."
        )
    if not (sigma > 0).all():
        raise ValueError(
            f"`error` must be positive; {int((~(sigma > 0)).sum())} of {count} pixels that "
            "count are 0, negative or NaN."
        )
    order = np.argsort(sigma, kind="stable")
    parts = np.array_split(order, groups)
    # Means of the first ones in either order, over the mean of all.
    first = count - np.arange(groups) * count // groups
    mean = size.mean() if size.any() else 1.0
    sparsified, oracle = (
        np.cumsum(s)[first - 1] / first / mean for s in (size[order], np.sort(size))
    )
    return Calibration(
        within=np.array([(size <= k * sigma).mean() for k in _MULTIPLES]),
        predicted=np.array([np.median(sigma[part]) for part in parts]),
        found=np.array([np.quantile(size[part], 0.683) for part in parts]),
        left_out=np.arange(groups) / groups,
        sparsified=sparsified,
        oracle=oracle,
        ause=float((sparsified - oracle).mean()),
    )
