"""The part `labels`: puts the labels of edge points onto pixels."""

from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax._params import cast, number
from mvedge_jax._paths import replaced
from mvedge_jax.edges import EdgePoints, rasterize, share
from mvedge_jax.edges.sides import Sides
from mvedge_jax.interpolation import exact_shift
from mvedge_jax.photometry import Evidence
from mvedge_jax.splatting import SplatLabels


def _splat() -> SplatLabels:
    """Narrow splats: at depth steps, wide points would hide the surface behind them."""
    return replaced(SplatLabels(), {"widths.sigma_label": 0.15, "widths.sigma_weight": 0.4})


class Labels(NamedTuple):
    """Labels and data weights per pixel.

    Attributes:
        weight: relative to that of a perfect label, `[y, x]`.
        value: disparity, `[y, x]`.
    """

    weight: Float[Array, "y x"]
    value: Float[Array, "y x"]


@runtime_checkable
class PointLabels(Protocol):
    """Puts the labels of edge points onto pixels; called inside `jit`.

    Points that are not valid change neither value nor gradient. Pixels without a point have weight
    0.
    """

    def __call__(
        self, points: EdgePoints, sides: Sides, evidence: Evidence, precision: Float[Array, ""]
    ) -> Labels:
        """Labels per pixel.

        Args:
            points: the edge points.
            sides: on which side of its edge each point belongs.
            evidence: calibrated views and measurement.
            precision: standard error, px, at which a label counts half as much as a perfect one.

        Returns:
            See `Labels`.
        """
        ...


class SharedLabels(eqx.Module):
    """Labels on either side of their edges, shared by the pixels of their surface.

    For chains with dense labels: the first map shows which pixels are on a point's surface.

    Attributes:
        weight: weight of a point's label relative to a dense one.
        agreement: distance of a label from the first map at which its share is a quarter.
    """

    weight: Float[Array, ""] = number(0.5, "dense labels")
    agreement: Float[Array, ""] = number(0.15, "px")

    def __call__(
        self, points: EdgePoints, sides: Sides, evidence: Evidence, precision: Float[Array, ""]
    ) -> Labels:
        """See `PointLabels`."""
        if evidence.measured is None:
            raise ValueError("`SharedLabels` need a `measurement` in the chain, got None.")
        first, surface = evidence.measured.disparity, sides.surface
        params = cast(self, first.dtype)
        # A point's disparity comes from few pixels, so noise affects it more.
        trusted = params.weight * (1 - evidence.calibrated.noise.alpha) * points.confidence
        weight = trusted * precision_weight(points.error**2, precision)
        weight = jnp.where(points.valid, weight, 0)
        total, mean = jnp.zeros_like(first), jnp.zeros_like(first)
        for sign, likely in ((1.0, surface.forward), (-1.0, 1 - surface.forward)):
            place = points.xy + sign * exact_shift(surface.length * points.normal)
            amount, value = share(place, points.disparity, weight * likely, first, params.agreement)
            total, mean = total + amount, mean + amount * value
        return Labels(total, mean / jnp.where(total > 0, total, 1))


class PointWeight(eqx.Module):
    r"""Data weights of points: from standard errors, and from the depth-edge confidence.

    The weight by the standard error is multiplied by $(1 + e^{\min(a \lambda_e, l) - l}) / 2$,
    which lies between one half and 1.

    Attributes:
        gain: $a$, of the depth-edge confidence in the exponent of the data weight (Eq. 6.3).
        limit: $l$, the largest exponent; the thesis' weight is unbounded.

    Source: Thesis 6.1, Eq. 6.3; the standard errors are ours.
    """

    gain: Float[Array, ""] = number(3.0, "1/px")
    limit: Float[Array, ""] = number(4.0)

    def __call__(
        self,
        confidence: Float[Array, " n"],
        points: EdgePoints,
        precision: Float[Array, ""],
    ) -> Float[Array, " n"]:
        """Weights of points.

        Args:
            confidence: `Sides.confidence`, px.
            points: `error` and `valid` are read.
            precision: standard error that halves a weight, px.

        Returns:
            Weights in [0, 1], 0 in slots without a point. Differentiable.
        """
        precise = precision_weight(points.error**2, precision)
        step = StepWeight(self.gain, self.limit)(confidence, points, precision)
        return jnp.where(points.valid, precise * 0.5 * (1 + step), 0)


class StepWeight(eqx.Module):
    r"""Data weights of points by their depth-edge confidence, $e^{\min(a \lambda_e, l) - l}$.

    This is $\omega e^{\min(a \lambda_e, l)}$ divided by its largest value; `Refine.stiffness` has
    the ratio to the smoothness that $\omega$ sets.

    Attributes:
        gain: $a$.
        limit: $l$, the largest exponent; the thesis' weight is unbounded.

    Source: Thesis 6.1, Eq. 6.3.
    """

    gain: Float[Array, ""] = number(3.0, "1/px")
    limit: Float[Array, ""] = number(4.0)

    def __call__(
        self,
        confidence: Float[Array, " n"],
        points: EdgePoints,
        precision: Float[Array, ""],
    ) -> Float[Array, " n"]:
        """See `PointWeight`; no standard error is read."""
        del precision
        params = cast(self, confidence.dtype)
        exponent = jnp.minimum(params.gain * confidence, params.limit) - params.limit
        return jnp.where(points.valid, jnp.exp(exponent), 0)


class NearestLabels(eqx.Module):
    """Puts each label on the pixel that its surface vector points to; the nearest surface wins.

    Attributes:
        weight: of the points.

    Source: Thesis 6.1.
    """

    weight: PointWeight | StepWeight = eqx.field(default_factory=PointWeight)

    def __call__(
        self, points: EdgePoints, sides: Sides, evidence: Evidence, precision: Float[Array, ""]
    ) -> Labels:
        """See `PointLabels`."""
        weight = self.weight(sides.confidence, points, precision)
        place = points.xy + sides.surface.offset
        raster = rasterize(place, points.disparity, points.valid, evidence.shape)
        return Labels(raster.values(weight), raster.values(points.disparity))


class SplattedLabels(eqx.Module):
    """Super-Gaussian splats on the surfaces of the edges, composited front to back (Thesis 7.1).

    This is the splat of the model of Chapter 7, whose points can move.

    Attributes:
        splat: widths, density and raster.
        clearing: c; a point of weight w has the opacity $1 - e^{-c w}$, so that a point without
            information hides nothing.
        weight: of the points.
        uncovered: coverage at which a label has half of its weight; below, rounding in single
            precision dominates.

    Source: Thesis 7.1.2-7.1.3.
    """

    splat: SplatLabels = eqx.field(default_factory=_splat)
    clearing: Float[Array, ""] = number(1.0)
    weight: PointWeight = eqx.field(default_factory=PointWeight)
    uncovered: Float[Array, ""] = number(1e-3, "coverage")

    def __call__(
        self, points: EdgePoints, sides: Sides, evidence: Evidence, precision: Float[Array, ""]
    ) -> Labels:
        """See `PointLabels`."""
        params = cast(self, points.disparity.dtype)
        weight = params.weight(sides.confidence, points, precision)
        maps = params.splat(
            points.xy + sides.surface.offset,
            points.disparity,
            weight,
            points.valid,
            evidence.shape,
            opacity=-jnp.expm1(-params.clearing * weight),
        )
        # Rounding dominates a label whose pixel is hardly covered.
        coverage = 1 - maps.transmittance
        return Labels(maps.weight * coverage / (coverage + params.uncovered), maps.label)


def precision_weight(variance: Array, precision: Float[Array, ""]) -> Array:
    """Weight of a label against that of a perfect one.

    Args:
        variance: variance of the label, px².
        precision: the standard error that halves the weight, px.

    Returns:
        The weight, at most 1. Differentiable.
    """
    square = precision**2
    return square / (square + variance)
