"""Cubic B-spline interpolation along one axis: the coefficients."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_POLE = np.sqrt(3.0) - 2.0
# The inverse filter decays by 0.27 per sample; 1e-7 of it is left at this radius.
_RADIUS = 12


def spline_coefficients(values: Float[Array, "*s"], *, axis: int) -> Float[Array, "*s"]:
    """Coefficients of the cubic B-spline through `values` along an axis, mirrored at the ends.

    The recursive inverse filter is written as a short symmetric one: XLA runs it as one fused
    stencil, where two recursions over the axis would be sequential.

    Args:
        values: samples, any shape.
        axis: along which to interpolate.

    Returns:
        Coefficients of the same shape. Linear, hence differentiable.
    """
    moved = jnp.moveaxis(values, axis, -1)
    size = moved.shape[-1]
    kernel = _POLE ** np.abs(np.arange(-_RADIUS, _RADIUS + 1))
    kernel = jnp.asarray(kernel / kernel.sum(), values.dtype)
    # Mirroring without repeating the border sample, for axes shorter than the filter as well.
    period = max(2 * size - 2, 1)
    index = np.abs(np.arange(-_RADIUS, size + _RADIUS)) % period
    padded = moved[..., np.minimum(index, period - index) if size > 1 else index * 0]
    total = sum(
        (kernel[i] * padded[..., i : i + size] for i in range(1, 2 * _RADIUS + 1)),
        kernel[0] * padded[..., :size],
    )
    return jnp.moveaxis(total, -1, axis)
