"""The losses of the optimization: self-supervised by the views, or supervised by a map."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy, cast, number
from mvedge_jax.warping import visible as exact_visible

from ._views import Views
from .features import Colors
from .terms import (
    Features,
    edge_aware_smoothness,
    gradient_reward,
    reprojection_error,
    ssim,
    warp_views,
)


class LossWeights(eqx.Module):
    """Weights of the terms of (7.16), all traced.

    Attributes:
        reprojection: of the mean error (7.15).
        smoothness: w_s, of the edge-aware smoothness (0.05 light fields, 0.0075 multi-view
            stereo).
        dissimilarity: of 1 - SSIM (0 light fields, 0.05 multi-view stereo).
        gradient: w_g, of the gradient reward.
    """

    reprojection: Float[Array, ""] = number(1.0)
    smoothness: Float[Array, ""] = number(0.05)
    dissimilarity: Float[Array, ""] = number(0.0)
    gradient: Float[Array, ""] = number(0.01)


class LossTerms(NamedTuple):
    """The terms before weighting, and the error map.

    Attributes:
        reprojection: mean of `error`.
        smoothness: edge-aware smoothness of the map.
        dissimilarity: 1 - SSIM, or 0 without `similarity`.
        gradient: mean gradient of the summed error, to be rewarded.
        error: E of (7.15), per pixel.
    """

    reprojection: Float[Array, ""]
    smoothness: Float[Array, ""]
    dissimilarity: Float[Array, ""]
    gradient: Float[Array, ""]
    error: Float[Array, "y x"]

    def weighted(self, weights: LossWeights) -> Float[Array, ""]:
        """The loss (7.16), differentiable."""
        return (
            weights.reprojection * self.reprojection
            + weights.smoothness * self.smoothness
            + weights.dissimilarity * self.dissimilarity
            - weights.gradient * self.gradient
        )


@accepts_numpy
def occlusion_masks(disparity: Float[Array, "y x"], views: Views) -> Bool[Array, "k y x"]:
    """Pixels of the center view that each view shows, without gradient.

    Args:
        disparity: of the center view.
        views: the views; masks of missing ones are 0.

    Returns:
        M of (7.15).
    """
    seen = jax.lax.map(lambda step: exact_visible(disparity, step), views.steps)
    return seen & views.available[:, None, None]


@accepts_numpy
def self_supervised_loss(
    disparity: Float[Array, "y x"],
    views: Views,
    weights: LossWeights,
    *,
    visible: Bool[Array, "k y x"] | None = None,
    features: Features | None = None,
    similarity: bool = False,
) -> tuple[Float[Array, ""], LossTerms]:
    """The loss (7.16): photometric error of the views, warped by a disparity map.

    Args:
        disparity: of the center view, px per view step.
        views: the views.
        weights: of the terms.
        visible: mask M; by default the exact z-buffer of `disparity`.
        features: image features to compare; colors by default.
        similarity: compute the SSIM term at all; it costs as much as the rest.

    Returns:
        The loss and its terms. Differentiable with respect to `disparity`, the views and the
        weights.

    Source: Thesis 7.1.4, Eq. 7.15-7.16; docs/method.md has signs and weights.
    """
    weights = cast(weights, disparity.dtype)
    visible = occlusion_masks(disparity, views) if visible is None else visible
    features = Colors() if features is None else features
    error = reprojection_error(disparity, views, visible, features)
    # The reward looks at the error summed over views, as the authors' code does.
    count = jnp.sum(visible & views.available[:, None, None], axis=0).astype(error.dtype)
    reward = jnp.mean(gradient_reward(error * jnp.maximum(count, 1)))
    dissimilarity = jnp.zeros((), disparity.dtype)
    if similarity:
        warped = warp_views(disparity, views, visible & views.available[:, None, None])
        alike = jax.vmap(lambda image: jnp.mean(ssim(image, views.center)))(warped)
        shown = jnp.maximum(jnp.sum(views.available).astype(alike.dtype), 1)
        dissimilarity = jnp.sum(jnp.where(views.available, 1 - alike, 0)) / shown
    smoothness = jnp.mean(edge_aware_smoothness(disparity, views.center))
    terms = LossTerms(jnp.mean(error), smoothness, dissimilarity, reward, error)
    return terms.weighted(weights), terms


class SupervisedWeights(eqx.Module):
    """Weights of the supervised loss.

    Attributes:
        absolute: of the mean absolute error.
        square: of the mean squared error. The thesis has none (0); with it, few large errors
            count.
    """

    absolute: Float[Array, ""] = number(1.0)
    square: Float[Array, ""] = number(3.0)


@accepts_numpy
def supervised_loss(
    disparity: Float[Array, "y x"],
    truth: Float[Array, "y x"],
    valid: Bool[Array, "y x"],
    weights: SupervisedWeights,
) -> Float[Array, ""]:
    """Distance from a known map, over the pixels where it is known.

    Args:
        disparity: px per view step.
        truth: the known map.
        valid: where it is known.
        weights: of the terms.

    Returns:
        The loss; zero if no pixel is known.

    Source: Thesis 7.1.4 and 7.2.3.
    """
    weights = cast(weights, disparity.dtype)
    error = jnp.where(valid, disparity - jnp.where(valid, truth, 0), 0)
    count = jnp.maximum(jnp.sum(valid).astype(disparity.dtype), 1)
    total = weights.absolute * jnp.sum(jnp.abs(error)) / count
    return total + weights.square * jnp.sum(error**2) / count
