"""Parameters of the brightness and the noise of the views."""

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, number


class NoiseModel(eqx.Module):
    """Factors from observed scatter to the noise of the views.

    Attributes:
        single: noise divided by the second differences in the smoothest fifth of an image;
            measured on white noise.
        between: noise divided by the least residual of some thirty hypotheses and two half arms;
            measured on white noise.
        finest: quantization step of views without steps of 8 or 10 bits, for the accuracy of
            interpolation and rendering.
        excess: variance removed from a guide, relative to that of its noise. It is above 1 because
            the local variance scatters, and remaining noise looks like texture.
        finer: number of disparities tried for each hypothesis.
    """

    single: Float[Array, ""] = number(1 / 0.85, "second differences")
    between: Float[Array, ""] = number(1.30, "unexplained deviations")
    finest: Float[Array, ""] = number(0.1 / 255, "sRGB")
    excess: Float[Array, ""] = number(1.15, "noise variances")
    finer: int = eqx.field(static=True, default=4)

    def __check_init__(self) -> None:
        at_least(self, finer=1)


class Brightness(eqx.Module):
    """Parameters of exposure, gains, vignettes, noise and vignette mask.

    Attributes:
        bright: 99th percentile of a bright, matt scene. Darker scenes are brightened to it,
            because floors are chosen for it.
        brightest: largest factor of the brightening.
        gain_prior: differences of gains up to this are attributed to the scene, not to the
            cameras.
        alike: number of blocks with a common error by parallax, some 4x4.
        blur: standard deviation of the blur against the bias of gains by noise.
        vignette_rough: variation over the frame of a view's brightness relative to the center
            view's, as a standard deviation of logs, that is attributed to the scene while no
            disparity is known.
        vignette_prior: the same along a disparity map.
        vignette_common: the radial vignette common to all views is set to 0 if its standard
            deviation over the frame is at most this.
        vignette_outlier: deviation of a log ratio of brightness from the fit beyond which its
            weight falls.
        vignette_side: least shorter side of the views for which `vignette_rough` and
            `vignette_prior` hold; for smaller views, in which parallax moves a larger part, they
            grow in proportion.
        black: brightness below which a pixel of the center view is black.
        dark: brightness below which a pixel of the other views is dark.
        noise: parameters of the noise and of the denoising of the guide.
        vignette_steps: steps of gradient descent of the vignette fit.
        blur_reach: radius of the blur, px.
        dark_reach: margin around the vignette mask, whose windows overlap it, px.
    """

    bright: Float[Array, ""] = number(0.56, "sRGB")
    brightest: Float[Array, ""] = number(16.0)
    gain_prior: Float[Array, ""] = number(0.002)
    alike: Float[Array, ""] = number(16.0, "places")
    blur: Float[Array, ""] = number(2.0, "px")
    vignette_rough: Float[Array, ""] = number(0.016)
    vignette_prior: Float[Array, ""] = number(0.008)
    vignette_common: Float[Array, ""] = number(0.05)
    vignette_outlier: Float[Array, ""] = number(0.03)
    vignette_side: Float[Array, ""] = number(160.0, "px")
    black: Float[Array, ""] = number(0.5 / 255, "sRGB", threshold=True)
    dark: Float[Array, ""] = number(0.02, "sRGB", threshold=True)
    noise: NoiseModel = eqx.field(default_factory=NoiseModel)
    vignette_steps: int = eqx.field(static=True, default=24)
    blur_reach: int = eqx.field(static=True, default=5)
    dark_reach: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        at_least(self, vignette_steps=2, blur_reach=1, dark_reach=0)
