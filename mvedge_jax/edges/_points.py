"""Multi-view edge points: the sparse, labeled features of the method."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import jax_array, readable


class EdgePoints(eqx.Module):
    """A padded set of points of the center view, each on an edge visible in many views.

    Slots that are not `valid` hold zeros and mean nothing.

    Attributes:
        xy: position in the center view, px, sub-pixel along the directions in which an edge was
            found; of detected points, in single precision, multiples of 1/1024 px (`exact_shift`).
        disparity: px per view step, larger is nearer.
        confidence: strength of the edge in (0, 1).
        error: standard error of `disparity`, px, from the residuals and the contrast around the
            point.
        normal: unit direction of the image gradient, `(x, y)`.
        visible: views of the crosshair that show the point: the vertical arm first, then
            the horizontal one.
        valid: which slots hold a point.
    """

    xy: Float[Array, "n 2"] = eqx.field(converter=jax_array)
    disparity: Float[Array, " n"] = eqx.field(converter=jax_array)
    confidence: Float[Array, " n"] = eqx.field(converter=jax_array)
    error: Float[Array, " n"] = eqx.field(converter=jax_array)
    normal: Float[Array, "n 2"] = eqx.field(converter=jax_array)
    visible: Bool[Array, "n s"] = eqx.field(converter=jax_array)
    valid: Bool[Array, " n"] = eqx.field(converter=jax_array)

    def masked(self) -> "EdgePoints":
        """The same points, with zeros in slots that are not valid."""

        def only(values: Array) -> Array:
            there = self.valid.reshape(-1, *[1] * (values.ndim - 1))
            return jnp.where(there, values, jnp.zeros_like(values))

        return replace(jax.tree.map(only, self), valid=self.valid)


class EdgeStats(eqx.Module):
    """Number of points after each step of `multiview_edges`.

    Attributes:
        candidates: pixels at which the filter bank found an edge along a row or a column.
        overflow: candidates without a slot; the weakest are left out.
        consistent: candidates whose disparity the views determine.
        valid: points returned: consistent candidates outside of the vignette mask.
    """

    candidates: Int[Array, ""]
    overflow: Int[Array, ""]
    consistent: Int[Array, ""]
    valid: Int[Array, ""]

    def __repr__(self) -> str:
        return readable(self)


class Edges(eqx.Module):
    """The result of `multiview_edges`.

    Attributes:
        points: the edge points.
        stats: counts of each step.
    """

    points: EdgePoints
    stats: EdgeStats
