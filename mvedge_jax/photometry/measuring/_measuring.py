"""Parameters of the photometric measurement."""

from typing import Literal, get_args

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, number, one_of

LabelViews = Literal["crosshair", "all"]


class Measurement(eqx.Module):
    """Disparity and standard error of every pixel around a map, from the views that show it.

    Attributes:
        drift: how much more a drift of the colours from view to view must explain, around a
            pixel, than it does of noise, for half of it to be believed; 0 believes every drift.
        same_surface: neighbours whose disparity differs by much more than this do not take part in
            a pixel's measurement.
        plain: where nothing is known of disparities, those of one surface may differ this many
            times more.
        scatter: disparities of one surface, found pixel by pixel, differ by this many times what a
            map's do: so much is allowed for where pixels' labels are averaged.
        same_colour: nor do those whose CIELAB colour differs by much more than this.
        outlier: residuals this many times larger than the noise stop counting.
        error_floor: smallest standard error: what interpolation and the pixels' own sampling make
            of an outline is alike in many views, so that neither noise nor their number tells it.
        surest: evidence for a drift below this share of what half of the drift needs counts alike.
        least_noise: standard errors never take noise for less than this many times that of
            rounding.
        least_share: where the signal is a smaller share of the information than this, it does not
            move the map.
        largest_step: a measurement moves by at most this.
        slant: differences of disparity below this are slant, not occlusion.
        radius: how far occluders are looked for, px.
        passes: over the neighbors whose measurements are shared, see `labels`.
        views: which of them labels are measured in: `"crosshair"`, or, in two more solves at the
            end, `"all"`.
    """

    drift: Float[Array, ""] = number(0.7, "noise variances")
    same_surface: Float[Array, ""] = number(0.02, "px")
    same_colour: Float[Array, ""] = number(8.0, "CIELAB")
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


class Measuring(Measurement):
    """The same in views of a certain noise, which may hide the colours of surfaces.

    Attributes:
        stiffness: how sure it is from the start that colours do not drift: 1 says nothing; larger
            where noise would pass for drift.
        noise: standard deviation of the images' noise, quantisation and interpolation included, in
            units of sRGB; the floor of what residuals are taken to mean.
        rounding: standard deviation of what the images were rounded by, as much larger as they
            were made brighter, sRGB. No residual means less, and standard errors know noise no
            better than `least_noise` says: over many views the mean of a window is finer than the
            step of a single colour.
        gradient_noise: energy of an image's derivative per variance of its noise, 1/px². For white
            noise and cubic splines it is 2.49; blurred views have less.
    """

    stiffness: Float[Array, ""] = number(1.0, "squared view steps")
    noise: Float[Array, ""] = number(1.5 / 255, "sRGB")
    rounding: Float[Array, ""] = number(1 / 255 / 12**0.5, "sRGB")
    gradient_noise: Float[Array, ""] = number(2.5, "1/px²")
