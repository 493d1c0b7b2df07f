"""Parameters of the photometric measurement."""

from typing import Literal, get_args

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, number, one_of

LabelViews = Literal["crosshair", "all"]


class Measurement(eqx.Module):
    """Disparity and standard error of every pixel around a map, from the views that show it.

    Attributes:
        drift: ratio of the variance that a drift of the colors explains around a pixel to what it
            explains of noise, at which half of the drift is accepted; 0 accepts every drift.
        same_surface: neighbors whose disparity differs by much more than this have no weight in a
            pixel's measurement.
        plain: factor of `same_surface` where disparities are undetermined.
        scatter: factor of `same_surface` where labels of pixels are averaged, because they scatter
            more than a map.
        same_color: neighbors whose CIELAB color differs by much more than this have no weight
            either.
        outlier: residuals this many times larger than the noise lose their weight.
        error_floor: smallest standard error. Errors of interpolation and of the sampling of
            outlines are common to many views, so the residual does not contain them.
        surest: lower bound of the evidence for a drift, as a share of the evidence at which half
            of the drift is accepted.
        least_noise: lower bound of the noise in standard errors, in multiples of the rounding
            error.
        least_share: least share of the signal in the information at which the map moves.
        largest_step: largest step of a measurement.
        slant: differences of disparity below this are slant, not occlusion.
        radius: largest distance of occluders, px.
        passes: passes over the neighborhood, see `labels`.
        views: the views to measure labels in: `"crosshair"`, or `"all"`, in two more solves at the
            end.
    """

    drift: Float[Array, ""] = number(0.7, "noise variances")
    same_surface: Float[Array, ""] = number(0.02, "px")
    same_color: Float[Array, ""] = number(8.0, "CIELAB")
    outlier: Float[Array, ""] = number(1.0, "noise variances")
    error_floor: Float[Array, ""] = number(0.004, "px")
    plain: Float[Array, ""] = number(5.0, "same_surface")
    scatter: Float[Array, ""] = number(3.5, "same_surface")
    surest: Float[Array, ""] = number(0.1, "drift")
    least_noise: Float[Array, ""] = number(1.386, "rounding deviations")
    least_share: Float[Array, ""] = number(1e-4, "of the information")
    largest_step: Float[Array, ""] = number(0.2, "px")
    slant: Float[Array, ""] = number(0.05, "px", threshold=True)
    radius: int = eqx.field(static=True, default=1)
    passes: int = eqx.field(static=True, default=2)
    views: LabelViews = eqx.field(static=True, default="crosshair")

    def __check_init__(self) -> None:
        at_least(self, radius=1, passes=0)
        one_of(self, views=get_args(LabelViews))


class AdaptedMeasurement(Measurement):
    """Parameters of a measurement in views of a given noise.

    Attributes:
        stiffness: factor of the prior against drift, 1 without noise; larger where noise looks
            like drift.
        noise: standard deviation of the images' noise, quantization and interpolation included, in
            units of sRGB; a lower bound of residuals.
        rounding: standard deviation of the rounding error, scaled by the brightening, sRGB: a
            lower bound of residuals. `least_noise` bounds the noise in standard errors, because
            the mean of a window over many views is finer than the step of a single color.
        gradient_noise: energy of an image's derivative per variance of its noise, 1/px². For white
            noise and cubic splines it is 2.49; blurred views have less.
    """

    stiffness: Float[Array, ""] = number(1.0, "squared view steps")
    noise: Float[Array, ""] = number(1.5 / 255, "sRGB")
    rounding: Float[Array, ""] = number(1 / 255 / 12**0.5, "sRGB")
    gradient_noise: Float[Array, ""] = number(2.5, "1/px²")
