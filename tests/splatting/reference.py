"""The reference splat, slow and simple: every point at every pixel."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import cast
from mvedge_jax.splatting import Splat, SplatRaster, SplatWidths, absorption
from mvedge_jax.splatting._tiles import depth_order


def splat_reference(
    xy: Float[Array, "n 2"],
    label: Float[Array, "n"],
    weight: Float[Array, "n"],
    valid: Bool[Array, "n"],
    widths: SplatWidths,
    shape: tuple[int, int],
    raster: SplatRaster,
    *,
    opacity: Float[Array, "n"] | None = None,
) -> Splat:
    """Like `splat`, without tiles, lists, radius or custom gradient; differentiable by JAX."""
    widths = cast(widths, xy.dtype)
    order = depth_order(jax.lax.stop_gradient(label), valid, raster.nearest)
    xy, label, weight, valid = xy[order], label[order], weight[order], valid[order]
    y, x = jnp.meshgrid(
        jnp.arange(shape[0], dtype=xy.dtype), jnp.arange(shape[1], dtype=xy.dtype), indexing="ij"
    )
    dx = x[None] - xy[:, 0, None, None]
    dy = y[None] - xy[:, 1, None, None]
    square = dx**2 + dy**2
    on = valid[:, None, None]
    through_center = widths.density * widths.sigma_depth * (2 * jnp.pi) ** 0.5
    gaussian = jnp.where(on, jnp.exp(-square / (2 * widths.sigma_label**2)), 0)
    if opacity is not None:
        gaussian = gaussian * opacity[order][:, None, None]
    absorbed, _, _, constant = absorption(through_center * gaussian, raster.absorption)
    optical = constant * through_center * gaussian
    in_front = jnp.exp(-(jnp.cumsum(optical, axis=0) - optical))
    power = (square / (2 * widths.sigma_weight**2)) ** raster.order
    flat = jnp.where(on, jnp.exp(-power), 0)
    zero = jnp.zeros((), jnp.int32)
    return Splat(
        jnp.sum(label[:, None, None] * absorbed * in_front, axis=0),
        jnp.sum(weight[:, None, None] * flat * in_front, axis=0),
        jnp.exp(-jnp.sum(optical, axis=0)),
        zero,
        zero,
        jnp.zeros((), xy.dtype),
    )
