"""Color spaces, differentiable: sRGB to linear light, CIE L*a*b* and gray."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax._product import product

# IEC 61966-2-1 primaries with the D65 white point of the 2 degree observer.
_XYZ_FROM_RGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
_LUMA = np.array([0.299, 0.587, 0.114])
_LAB_DELTA = 6.0 / 29.0


def _require_rgb(image: Array, name: str) -> None:
    if image.ndim < 1 or image.shape[-1] != 3:
        raise ValueError(
            f"`{name}` must have three color channels on its last axis, got shape {image.shape}."
        )


@accepts_numpy
def srgb_to_linear(image: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """Undoes the sRGB transfer curve.

    Args:
        image: sRGB values in [0, 1], any shape.

    Returns:
        Linear-light values in [0, 1], same shape. Differentiable, also at 0 (the linear toe).

    Source: IEC 61966-2-1.

    Example:
        >>> import jax.numpy as jnp
        >>> srgb_to_linear(jnp.array([0.0, 0.5, 1.0])).round(4).tolist()
        [0.0, 0.2140, 1.0]
    """
    toe = image <= 0.04045
    # The power is evaluated at a safe value where it is not selected: no NaN in the gradient.
    curve = ((jnp.where(toe, 1.0, image) + 0.055) / 1.055) ** 2.4
    return jnp.where(toe, image / 12.92, curve).astype(image.dtype)


@accepts_numpy
def srgb_to_lab(image: Float[Array, "*s c"]) -> Float[Array, "*s c"]:
    """Converts sRGB to CIE Lab (L*, a*, b*; D65).

    Args:
        image: sRGB values in [0, 1], channels last.

    Returns:
        `L` in 0..100, `a` and `b` about -100..100, same shape. Differentiable everywhere: black
        lies on the linear part of the cube-root curve.

    Raises:
        ValueError: if the last axis does not hold three channels.

    Source: CIE 15; the thesis' EPI stages work on these values.

    Example:
        >>> import jax.numpy as jnp
        >>> srgb_to_lab(jnp.ones(3))[0].round(1).item()
        100.0
    """
    _require_rgb(image, "image")
    matrix = jnp.asarray(_XYZ_FROM_RGB / _XYZ_FROM_RGB.sum(1, keepdims=True), image.dtype)
    xyz = product(srgb_to_linear(image), matrix.T)
    toe = xyz <= _LAB_DELTA**3
    root = jnp.cbrt(jnp.where(toe, 1.0, xyz))
    f = jnp.where(toe, xyz / (3 * _LAB_DELTA**2) + 4.0 / 29.0, root)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return jnp.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


@accepts_numpy
def planes_to_lab(planes: Float[Array, "*s c y x"]) -> Float[Array, "*s c y x"]:
    """Converts channel planes from sRGB to CIE Lab, see `srgb_to_lab`.

    Args:
        planes: sRGB values in [0, 1], channels before rows and columns.

    Returns:
        `L`, `a`, `b` as planes. Differentiable.

    Raises:
        ValueError: if there are not three planes.

    Example:
        >>> import jax.numpy as jnp
        >>> planes_to_lab(jnp.ones((3, 4, 5))).shape
        (3, 4, 5)
    """
    return jnp.moveaxis(srgb_to_lab(jnp.moveaxis(planes, -3, -1)), -1, -3)


@accepts_numpy
def srgb_to_gray(image: Float[Array, "*s c"]) -> Float[Array, "*s"]:
    """Rec. 601 luma of an sRGB image.

    Args:
        image: sRGB values in [0, 1], channels last.

    Returns:
        Gray values in [0, 1] without the channel axis. Linear, hence differentiable.

    Raises:
        ValueError: if the last axis does not hold three channels.
    """
    _require_rgb(image, "image")
    return product(image, jnp.asarray(_LUMA, image.dtype))


class Factored(NamedTuple):
    """A covariance of three colors and its triangular factors.

    Attributes:
        moments: covariances `rr, rg, rb, gg, gb, bb`, the variances raised.
        factors: three variances, each after those before it explained what they can, and the slopes
            of green on red, blue on red, blue on green.
    """

    moments: tuple[Float[Array, "*s"], ...]
    factors: tuple[Float[Array, "*s"], ...]


def factored(moments: Sequence[Float[Array, "*s"]], floor: Float[Array, ""]) -> Factored:
    """Factors covariances of three colors, each variance raised by some for safety.

    The triangular factors are exact enough in single precision where colors lie on a line, as they
    do around an edge; the adjugate is not.

    Args:
        moments: covariances `rr, rg, rb, gg, gb, bb`, of any shape.
        floor: added to `rr`, `gg`, `bb`; positive.

    Returns:
        What `solved` takes.
    """
    rr, rg, rb, gg, gb, bb = moments
    rr, gg, bb = rr + floor, gg + floor, bb + floor
    first = jnp.maximum(rr, floor)
    g_r, b_r = rg / first, rb / first
    # What is left of a variance after the others explain it is no less than was added.
    second = jnp.maximum(gg - g_r * rg, floor)
    b_g = (gb - b_r * rg) / second
    third = jnp.maximum(bb - b_r * rb - b_g * b_g * second, floor)
    return Factored((rr, rg, rb, gg, gb, bb), (first, second, third, g_r, b_r, b_g))


@jax.custom_jvp
def solved(
    covariance: Factored, color: Sequence[Float[Array, "*s"]]
) -> tuple[Float[Array, "*s"], ...]:
    """The inverse of a covariance times a vector.

    Args:
        covariance: of `factored`.
        color: a vector `r, g, b`.

    Returns:
        A vector of the same shape. Differentiable in moments and color.

    Example:
        >>> import jax.numpy as jnp
        >>> moments = [jnp.asarray(m) for m in (1.0, 0.0, 0.0, 3.0, 0.0, 1.0)]
        >>> [float(c) for c in solved(factored(moments, jnp.asarray(1.0)), (jnp.ones(()),) * 3)]
        [0.5, 0.25, 0.5]
    """
    first, second, third, g_r, b_r, b_g = covariance.factors
    r, g, b = color
    g = g - g_r * r
    b = (b - b_r * r - b_g * g) / third
    g = g / second - b_g * b
    return r / first - g_r * g - b_r * b, g, b


@solved.defjvp
def _solved_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """By the system itself: slopes of its factors leave single precision where colors are flat."""
    (covariance, _), (change, forcing) = primals, tangents
    solution = solved(*primals)
    r, g, b = solution
    rr, rg, rb, gg, gb, bb = change.moments
    pushed = (rr * r + rg * g + rb * b, rg * r + gg * g + gb * b, rb * r + gb * g + bb * b)
    return solution, solved(covariance, [f - p for f, p in zip(forcing, pushed, strict=True)])
