"""Widths of splatted points, and the raster they are splatted onto."""

import math
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from mvedge_jax._params import number

# Only for input checks: largest optical thickness, or share of the weight, at the radius where a
# point is cut off. The thesis' widths have 4e-4.
MOST_LOST = 1e-3


class SplatWidths(eqx.Module):
    """Widths and density of a splatted point, in pixels of the raster that is splatted to.

    Attributes:
        sigma_label: σ_S, width of the Gaussian that carries the label and the opacity.
        sigma_weight: σ_λ, width of the super-Gaussian that carries the data weight. The pixel
            nearest to a point, at most √½ away, keeps most of the weight.
        density: ρ, extinction per unit length at the center of a point. The thesis does not give
            it; 6.2 makes the thesis' 8-sample quadrature integrate to one.
        sigma_depth: σ_Z, width of a point along the ray. Only ρ σ_Z matters.

    Source:
        Thesis 7.1.5.
    """

    sigma_label: Float[Array, ""] = number(1.3, "raster px")
    sigma_weight: Float[Array, ""] = number(0.7054, "raster px")
    density: Float[Array, ""] = number(6.2, "1/raster px")
    sigma_depth: Float[Array, ""] = number(1.0, "raster px")


@dataclass(frozen=True)
class SplatRaster:
    """Static choices of the splat.

    Attributes:
        scale: raster pixels per image pixel and axis, 1 or 2 (thesis: 2).
        nearest: `"largest"` label in front (disparity) or `"smallest"` (depth).
        order: p, order of the super-Gaussian (thesis: 2).
        absorption: `"closed"` form, or the thesis' 8-sample `"quadrature"`.
        radius: raster pixels around a point inside which it is evaluated. At 6 px the opacity
            beyond is below 4e-4; the thesis' window ends at an opacity of 0.66.
        tile: side of the square tiles, each with its own depth-sorted list of points.
        lanes: tiles that are composited together, as one vector.
        capacity: most points per tile, nearest first, or None for no limit. Points beyond it are
            left out of that tile and counted in `Splat.overflow`.
    """

    scale: int = 2
    nearest: str = "largest"
    order: int = 2
    absorption: str = "closed"
    radius: int = 6
    tile: int = 8
    lanes: int = 128
    capacity: int | None = None

    def __post_init__(self) -> None:
        if self.scale not in (1, 2):
            raise ValueError(
                f"scale must be 1 or 2 raster pixels per image pixel, got {self.scale}."
            )
        if self.nearest not in ("largest", "smallest"):
            raise ValueError(f"nearest must be 'largest' or 'smallest', got {self.nearest!r}.")
        if self.absorption not in ("closed", "quadrature"):
            raise ValueError(
                f"absorption must be 'closed' or 'quadrature', got {self.absorption!r}."
            )
        for name in ("order", "radius", "tile", "lanes"):
            value = getattr(self, name)
            if value < 1:
                raise ValueError(f"{name} must be at least 1, got {value}.")
        if self.capacity is not None and self.capacity < 1:
            raise ValueError(f"capacity must be None or at least 1, got {self.capacity}.")

    def check(self, widths: SplatWidths) -> None:
        """Refuses widths that are too large for `radius` or not positive.

        Traced widths are not checked; `Splat.cut_off` has the number.

        Args:
            widths: widths of the points; of a batch, each is checked.

        Raises:
            ValueError: naming the value, and for widths the radius.
        """
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(widths)):
            return
        density, depth = (np.asarray(a, float) for a in (widths.density, widths.sigma_depth))
        if not (np.min(density) > 0 and np.min(depth) > 0):
            raise ValueError(
                "`density` and `sigma_depth` must be positive, got "
                f"{np.min(density):g} and {np.min(depth):g}."
            )
        thickness = float(np.max(density) * np.max(depth)) * math.sqrt(2 * math.pi)
        parts = (("sigma_label", thickness, 1), ("sigma_weight", 1.0, self.order))
        for name, whole, order in parts:
            given = np.asarray(getattr(widths, name), float)
            if not np.min(given) > 0:
                raise ValueError(f"`{name}` must be positive, got {float(np.min(given))}.")
            width = float(np.max(given))
            lost = whole * math.exp(-((0.5 * (self.radius / width) ** 2) ** order))
            if lost > MOST_LOST:
                raise ValueError(
                    f"Points of `{name}` = {width:.3g} px still count {lost:.2g} at `radius` = "
                    f"{self.radius} px, where they are cut off: ask for a larger radius "
                    "(`SplatRaster`), or narrower points."
                )

    def cut_off(self, widths: SplatWidths) -> Float[Array, ""]:
        """What a cut at `radius` removes of a point.

        Args:
            widths: widths of the points, traced or not.

        Returns:
            The larger of the optical thickness and the share of the data weight there. `check`
            refuses more than 1e-3. Without derivative.
        """
        widths = jax.lax.stop_gradient(widths)
        thickness = widths.density * widths.sigma_depth * math.sqrt(2 * math.pi)
        label = thickness * jnp.exp(-0.5 * (self.radius / widths.sigma_label) ** 2)
        half = 0.5 * (self.radius / widths.sigma_weight) ** 2
        return jnp.maximum(label, jnp.exp(-jax.lax.integer_pow(half, self.order)))
