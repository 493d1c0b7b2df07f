"""Depth profiles across edges, and the response of a step filter to them."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from mvedge_jax.interpolation import exact_shift, sample


def profiles(
    image: Float[Array, "y x"], xy: Float[Array, "n 2"], normal: Float[Array, "n 2"]
) -> Float[Array, "7 n"]:
    """Bilinear samples of a map at -3..3 px along every point's normal."""
    offsets = jnp.arange(-3, 4, dtype=image.dtype)
    return jax.lax.map(lambda k: sample(image, xy + exact_shift(k * normal)), offsets)


def step_response(
    profile: Float[Array, "7 n"],
    *,
    taps: tuple[float, ...] = (-1.0, -1.5, -2.0, 2.0, 1.5, 1.0),
) -> Float[Array, " n"]:
    r"""Response of a step filter to depth profiles, always ≥ 0.

    The thesis' filter $[-1, -1, 1, 1]$ has an even length, so its center lies between two samples.
    Of the two positions around the point, that on the side of the larger jump is used.

    Args:
        profile: samples at -3..3 px along the normal, any unit.
        taps: an even number of taps, at most 6, that sum to 0; scaled to respond to a step of 1
            with 2. The default weights the samples next to the edge more.

    Returns:
        Twice the height of a clean step. Differentiable where the larger jump does not change.

    Source: Thesis 4.2.2; Eq. 6.3.

    Example:
        >>> import jax.numpy as jnp
        >>> step = jnp.array([[0.0], [0.0], [0.0], [0.0], [1.0], [1.0], [1.0]])
        >>> step_response(step).tolist()
        [2.0]
    """
    first = 3 - len(taps) // 2
    scale = 4 / sum(map(abs, taps))

    def answer(start: int) -> Array:
        total = jnp.zeros_like(profile[0])
        for k, tap in enumerate(taps):
            total = total + scale * tap * profile[start + k]
        return jnp.abs(total)

    before = jnp.abs(profile[3] - profile[2]) > jnp.abs(profile[4] - profile[3])
    return jnp.where(before, answer(first), answer(first + 1))


def thesis_step(profile: Float[Array, "7 n"]) -> Float[Array, " n"]:
    """`step_response` of the thesis' own filter, `[-1, -1, 1, 1]`."""
    return step_response(profile, taps=(-1.0, -1.0, 1.0, 1.0))


def thesis_response(profile: Float[Array, "7 n"]) -> Float[Array, " n"]:
    """Response of the thesis' step filter to depth profiles stretched to [-1, 1].

    Args:
        profile: samples at -3..3 px along the normal, any unit.

    Returns:
        4 for a clean step of any height, 0 for a flat profile. Differentiable as `step_response`.

    Source: Thesis 4.2.2.
    """
    return thesis_step(stretched(profile))


def stretched(profile: Float[Array, "7 n"]) -> Float[Array, "7 n"]:
    """Depth profiles from -1 at their lowest to 1 at their highest sample; 0 where flat."""
    low, high = (f(profile, axis=0, keepdims=True) for f in (jnp.min, jnp.max))
    flat = high - low < 1e-6
    return jnp.where(flat, 0, 2 * (profile - low) / jnp.where(flat, 1, high - low) - 1)
