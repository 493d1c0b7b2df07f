"""Visible range of view steps of every pixel, from a disparity map alone."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float


def visible_view_range(
    disparity: Float[Array, "y x"], *, radius: int, step: Float[Array, ""] | float = 0.05
) -> tuple[Float[Array, "y x"], Float[Array, "y x"]]:
    r"""View steps along x beyond which a nearer pixel of the same row hides each pixel.

    A pixel at distance $j$ whose disparity is larger by $\Delta d$ lands on the pixel in the view
    that is $j / \Delta d$ steps away: towards positive steps $(u_c - u > 0)$ if it lies on
    the left, towards negative ones if it lies on the right. Views beyond the first such
    step count as hidden, though a thin occluder uncovers the pixel again further on.

    Args:
        disparity: px per view step, `[y, x]`, larger is nearer.
        radius: largest distance of occluders, px: the number of view steps times the largest
            difference of disparities.
        step: differences of disparity below this, px, are slant, not occlusion.

    Returns:
        Steps to the first hiding for negative and for positive steps, `[y, x]` each, infinite where
        nothing hides the pixel. A selection: no gradient passes.

    Source: Thesis 4.1.5, Eq. 4.4, for every pixel instead of the points.

    Example:
        >>> import jax.numpy as jnp
        >>> left, right = visible_view_range(jnp.array([[0.0, 0.0, 0.0, 1.0]]), radius=3)
        >>> left[0].tolist(), right[0].tolist()
        ([2.5, 1.5, 0.5, inf], [inf, inf, inf, inf])
    """
    disparity = lax.stop_gradient(disparity)
    width = disparity.shape[1]
    slant = jnp.asarray(step, disparity.dtype)
    never = jnp.full_like(disparity, jnp.inf)
    # Padding with the farthest surface: pixels outside of the image hide nothing.
    padded = jnp.pad(disparity, ((0, 0), (radius, radius)), constant_values=-jnp.inf)

    def nearest(least: tuple[Array, Array], distance: Array) -> tuple[tuple[Array, Array], None]:
        def hidden(other: Array) -> Array:
            difference = other - disparity
            hides = difference > slant
            return jnp.where(
                hides,
                (distance.astype(disparity.dtype) - 0.5) / jnp.where(hides, difference, 1),
                jnp.inf,
            )

        right = lax.dynamic_slice_in_dim(padded, radius + distance, width, axis=1)
        left = lax.dynamic_slice_in_dim(padded, radius - distance, width, axis=1)
        return (jnp.minimum(least[0], hidden(right)), jnp.minimum(least[1], hidden(left))), None

    (negative, positive), _ = lax.scan(nearest, (never, never), jnp.arange(1, radius + 1))
    return negative, positive
