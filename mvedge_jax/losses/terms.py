"""The terms of the losses: images against images, and maps against edges."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax._product import FULL
from mvedge_jax.warping import warp_planes

from ._views import Views

Features = Callable[[Float[Array, "c y x"]], Float[Array, "k y x"]]


def _sobel(planes: Float[Array, "*k y x"]) -> tuple[Float[Array, "*k y x"], Float[Array, "*k y x"]]:
    """Sobel derivatives, divided by 8 so that they are slopes per pixel; borders replicated."""
    pad = [(0, 0)] * (planes.ndim - 2) + [(1, 1), (1, 1)]
    p = jnp.pad(planes, pad, mode="edge")
    across = p[..., :, 2:] - p[..., :, :-2]
    down = p[..., 2:, :] - p[..., :-2, :]
    gx = (across[..., :-2, :] + 2 * across[..., 1:-1, :] + across[..., 2:, :]) / 8
    gy = (down[..., :, :-2] + 2 * down[..., :, 1:-1] + down[..., :, 2:]) / 8
    return gx, gy


@accepts_numpy
def warp_views(
    disparity: Float[Array, "y x"], views: Views, visible: Bool[Array, "k y x"]
) -> Float[Array, "k c y x"]:
    """Warps all views to the center; masked pixels show the center image.

    Args:
        disparity: of the center view, px per view step.
        views: the views to warp.
        visible: mask M of (7.15).

    Returns:
        Warped views. Differentiable with respect to `disparity` and the views.
    """

    def one(other: Array, step: Array, mask: Array) -> Array:
        warped = warp_planes(other, disparity, step.astype(disparity.dtype))
        return jnp.where(mask[None], warped, views.center)

    return jax.vmap(one)(views.others, views.steps, visible)


@accepts_numpy
def reprojection_error(
    disparity: Float[Array, "y x"], views: Views, visible: Bool[Array, "k y x"], features: Features
) -> Float[Array, "y x"]:
    r"""Difference of the warped views from the center view.

    $$ E = \frac{1}{\max(\sum_i M^i, 1)} \sum_i M^i
    \operatorname{mean}_c |F_c(I) - F_c(W[I^i])| $$

    Args:
        disparity: of the center view, px per view step.
        views: the views.
        visible: mask M, no gradient. Masked pixels are replaced by the center image before
            computing features, so that they do not affect the features of their neighbors.
        features: `features(image) -> [c, y, x]`.

    Returns:
        The error per pixel; zero where no view is visible.

    Source: Thesis 7.1.4, Eq. 7.15.
    """
    reference = features(views.center)
    visible = visible & views.available[:, None, None]

    def one(total: Array, item: tuple[Array, Array, Array]) -> tuple[Array, None]:
        other, step, mask = item
        warped = warp_planes(other, disparity, step.astype(disparity.dtype))
        warped = jnp.where(mask[None], warped, views.center)
        difference = jnp.mean(jnp.abs(features(warped) - reference), axis=0)
        return total + jnp.where(mask, difference, 0), None

    # One view at a time, which keeps the program small and one view's features in memory.
    total, _ = jax.lax.scan(one, jnp.zeros_like(disparity), (views.others, views.steps, visible))
    count = jnp.sum(visible, axis=0).astype(disparity.dtype)
    return total / jnp.maximum(count, 1)


@accepts_numpy
def gradient_reward(error: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Magnitude of the gradient of the reprojection error.

    Rewarded, it lets sharp depth edges keep the error that blurred image edges cause.

    Args:
        error: E of (7.15).

    Returns:
        Magnitude per pixel; Sobel, unnormalized as in the authors' code (8 times the slope).

    Source: Thesis 7.1.4, Eq. 7.16.
    """
    gx, gy = _sobel(error)
    return jnp.sqrt(64 * (gx**2 + gy**2) + 1e-10)


@accepts_numpy
def edge_aware_smoothness(
    disparity: Float[Array, "y x"], center: Float[Array, "c y x"]
) -> Float[Array, "y x"]:
    """Slope of the map where the image has no edge.

    Args:
        disparity: px per view step.
        center: the image.

    Returns:
        `|S_x D| exp(-mean |S_x I|)` plus the same in y, with unnormalized Sobel filters.

    Source: Thesis 7.1.4, E_S of Eq. 7.16.
    """
    return jnp.sum(jnp.abs(_edge_aware_slopes(disparity, center)), axis=0)


def _edge_aware_slopes(
    disparity: Float[Array, "y x"], center: Float[Array, "c y x"]
) -> Float[Array, "2 y x"]:
    """`S D exp(-mean |S I|)` across and down."""
    pairs = zip(_sobel(disparity), _sobel(center), strict=True)
    return jnp.stack(
        [8 * slope * jnp.exp(-8 * jnp.mean(jnp.abs(edge), axis=0)) for slope, edge in pairs]
    )


@accepts_numpy
def ssim(
    a: Float[Array, "c y x"], b: Float[Array, "c y x"], *, sigma: float = 1.5, radius: int = 5
) -> Float[Array, "y x"]:
    """Structural similarity of two images in [0, 1], averaged over channels.

    Args:
        a: an image.
        b: another.
        sigma: width of the Gaussian window, px.
        radius: half-width of the window; pixels nearer to the border see a replicated border.

    Returns:
        Similarity per pixel, 1 for equal images.

    Source: Wang et al. 2004, with constants .01² and .03²; thesis 7.1.4, E_SSIM.
    """
    axis = jnp.arange(-radius, radius + 1, dtype=a.dtype)
    window = jnp.exp(-(axis**2) / (2 * sigma**2))
    window = window / jnp.sum(window)

    def blur(planes: Array) -> Array:
        padded = jnp.pad(planes, ((0, 0), (radius, radius), (radius, radius)), mode="edge")
        blurred = padded[:, None]
        for taps in (window[None, None, :, None], window[None, None, None, :]):
            blurred = jax.lax.conv_general_dilated(blurred, taps, (1, 1), "VALID", precision=FULL)
        return blurred[:, 0]

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    similarity = similarity / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return jnp.mean(similarity, axis=0)
