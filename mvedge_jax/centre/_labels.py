"""Labels of the map: from the points, and measured at every pixel."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from mvedge_jax.photometry.measuring import Measuring, PhotometricLabels

from ._parameters import CentreParams
from .error import steepest

# A point whose disparity differs by this from the map, px, has a quarter of its weight.
AGREEMENT = 0.15
# Weight of the previous map itself, so that no region is without any label.
_ANCHOR = 1e-6
# A step of this, px, within this distance of a pixel halves the share that all views have in its
# label: the views of the corners look past an edge on two sides, and smear it. From cotton,
# backgammon, bench and demo.
_PARTED, _BESIDE = 0.1, 2


class Labels(NamedTuple):
    """Labels and data weights per pixel.

    Attributes:
        weight: against a perfect label, `[y, x]`.
        value: disparity, `[y, x]`.
    """

    weight: Array
    value: Array


def precision_weight(variance: Array, params: CentreParams) -> Array:
    """Weight of a label against that of a perfect one.

    Args:
        variance: of the label, px².
        params: `precision` is the standard error that halves the weight.

    Returns:
        The weight, at most 1. Differentiable.
    """
    precision = params.precision**2
    return precision / (precision + variance)


def with_dense(
    from_points: Labels,
    measured: PhotometricLabels,
    disparity: Array,
    params: CentreParams,
    measuring: Measuring,
    lit: Array | None,
) -> Labels:
    """Labels of the points together with one measured at every pixel."""
    weight = measured.weight(measuring, precision=params.precision, trust=params.trust)
    distance = (from_points.value - disparity) / AGREEMENT
    sparse = from_points.weight / (1 + distance**2) ** 2
    if lit is not None:
        weight, sparse = lit * weight, lit * sparse
    total = weight + sparse + _ANCHOR
    sums = weight * measured.disparity + sparse * from_points.value + _ANCHOR * disparity
    return Labels(total, sums / jnp.maximum(total, jnp.finfo(total.dtype).tiny))


def share_of_all(disparity: Array) -> Array:
    """Share of all views against the crosshair in the label of a pixel: 1 far from steps."""
    window = (2 * _BESIDE + 1,) * 2
    step = lax.reduce_window(steepest(disparity), -jnp.inf, lax.max, window, (1, 1), "SAME")
    return 1 / (1 + (step / _PARTED) ** 4)
