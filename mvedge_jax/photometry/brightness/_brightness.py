"""Parameters of what is found out about the brightness and the noise of the views."""

import equinox as eqx
from jaxtyping import Array, Float

from mvedge_jax._params import at_least, number


class NoiseModel(eqx.Module):
    """From what a scene's views scatter by to their noise.

    Attributes:
        single: noise over the second differences in the smoothest fifth of an image, which lie
            below it; measured on white noise.
        between: noise over the least of what some thirty hypotheses and two half arms leave
            unexplained; measured on white noise.
        finest: step of views that have none of 8 or 10 bits: interpolation and rendering are no
            finer.
        excess: variance that a guide loses as noise, a little more than it has: its own local
            variance scatters, and what is left over looks like texture.
        finer: disparities that are tried for each hypothesis.
    """

    single: Float[Array, ""] = number(1 / 0.85, "second differences")
    between: Float[Array, ""] = number(1.30, "unexplained deviations")
    finest: Float[Array, ""] = number(0.1 / 255, "sRGB")
    excess: Float[Array, ""] = number(1.15, "noise variances")
    finer: int = eqx.field(static=True, default=4)

    def __check_init__(self) -> None:
        at_least(self, finer=1)


class Brightness(eqx.Module):
    """How exposure, gains, vignettes, noise and what the lens leaves dark are found.

    Attributes:
        bright: where the 99th percentile of a bright, matt scene lies; floors are meant for such
            scenes, and darker ones are brightened to it.
        brightest: most that a scene is brightened.
        gain_prior: a scene whose gains differ by no more than this owes it to the scene, not to the
            cameras.
        alike: places that count as one, for parallax errs alike over some 4x4 of them.
        blur: standard deviation of the blur that keeps noise from shrinking gains.
        vignette_rough: a scene whose views' brightness against the centre view's varies over the
            frame by no more than this, as a standard deviation of logs, owes it to the scene and
            not to the lenses, as long as no disparity is known.
        vignette_prior: the same along a disparity map.
        vignette_common: what the lenses of all views, the centre view's too, take away from the
            center of the frame to its corners is 0 if its standard deviation over the frame is no
            more than this.
        vignette_outlier: log ratio of brightness beyond which a place speaks against the vignette
            of all others less and less.
        vignette_side: the first two are for views whose shorter side is at least this long; for
            smaller ones, of which parallax moves a larger part, they grow in proportion.
        black: brightness below which a pixel of the centre view is black.
        dark: brightness below which a pixel of the other views is dark.
        noise: how noise is measured and taken out of the guide.
        vignette_steps: of the descent to the vignettes.
        blur_reach: where that blur ends, px.
        dark_reach: pixels around what is unlit whose windows reach into it.
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
