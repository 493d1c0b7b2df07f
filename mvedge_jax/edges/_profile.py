"""Depth profiles across edges, and how much they look like a step."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def sample(image: Float[Array, "y x"], xy: Float[Array, "n 2"]) -> Float[Array, " n"]:
    """Bilinear samples of an image at `(x, y)`; outside, the border repeats. Differentiable."""
    coordinates = [xy[:, 1], xy[:, 0]]
    return jax.scipy.ndimage.map_coordinates(image, coordinates, order=1, mode="nearest")


def profiles(
    image: Float[Array, "y x"], xy: Float[Array, "n 2"], normal: Float[Array, "n 2"]
) -> Float[Array, "7 n"]:
    """Samples of a map at -3..3 px along every point's normal.

    Args:
        image: the map, `[y, x]`.
        xy: positions of the points, px.
        normal: unit direction per point.

    Returns:
        Bilinear samples, `[7, n]`, from the far side of the normal to its near side.
    """
    offsets = jnp.arange(-3, 4, dtype=image.dtype)
    return jax.lax.map(lambda k: sample(image, xy + k * normal), offsets)


def step_response(
    profile: Float[Array, "7 n"], *, normalised: bool = False, taps: str = "centred"
) -> Float[Array, " n"]:
    r"""Answer of a step filter to depth profiles, always ≥ 0.

    The thesis' filter $[-1, -1, 1, 1]$ has an even length, so its centre lies between two
    samples. Of the two positions around the point, the one on the side of the larger jump counts.

    Args:
        profile: samples at -3..3 px along the normal, any unit.
        normalised: stretch every profile to $[-1, 1]$ first, as the thesis does; a flat profile
            then has the answer 0. The plain answer picks the right side more often.
        taps: `"centred"` weighs the samples next to the edge more, `[-1, -1.5, -2, 2, 1.5, 1]`
            scaled to the answer of `"thesis"`, `[-1, -1, 1, 1]`, to a step.

    Returns:
        Twice the height of a clean step. Differentiable where the larger jump does not change.

    Source: Thesis 4.2.2; Eq. 6.3.

    Example:
        >>> import jax.numpy as jnp
        >>> step = jnp.array([[0.0], [0.0], [0.0], [0.0], [1.0], [1.0], [1.0]])
        >>> step_response(step).tolist()
        [2.0]
    """
    dtype = profile.dtype
    if normalised:
        low, high = (f(profile, axis=0, keepdims=True) for f in (jnp.min, jnp.max))
        flat = high - low < 1e-6
        profile = jnp.where(flat, 0, 2 * (profile - low) / jnp.where(flat, 1, high - low) - 1)
    if taps == "centred":
        kernel, first = jnp.asarray([-1.0, -1.5, -2.0, 2.0, 1.5, 1.0], dtype) * (2 / 4.5), 0
    elif taps == "thesis":
        kernel, first = jnp.asarray([-1.0, -1.0, 1.0, 1.0], dtype), 1
    else:
        raise ValueError(f"`taps` must be 'centred' or 'thesis'; it is {taps!r}.")
    count = kernel.shape[0]

    def answer(start: int) -> Array:
        total = jnp.zeros_like(profile[0])
        for k in range(count):
            total = total + kernel[k] * profile[start + k]
        return jnp.abs(total)

    before = jnp.abs(profile[3] - profile[2]) > jnp.abs(profile[4] - profile[3])
    return jnp.where(before, answer(first), answer(first + 1))
