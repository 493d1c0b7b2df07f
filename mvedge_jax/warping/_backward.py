"""Backward warping: samples another view at the positions given by a disparity map."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._params import accepts_numpy


@accepts_numpy
def backward_warp(
    image: Float[Array, "h w c"],
    disparity: Float[Array, "y x"],
    step: Float[Array, "2"],
) -> tuple[Float[Array, "y x c"], Bool[Array, "y x"]]:
    r"""Samples another view at the positions of the points of this one.

    A point at $(x, y)$ with disparity $d$ is at $(x + s_x d, y + s_y d)$ in the view that lies
    `step` away, so the warped image is $W(x, y) = I(x + s_x d(x, y),\, y + s_y d(x, y))$,
    interpolated bilinearly. Occlusion is not handled: where a nearer surface hides the point in
    `image`, the color of that surface is returned.

    Outside of `image` the color of the nearest border pixel is used, which has no gradient with
    respect to the disparity, and `inside` is False there.

    Args:
        image: The other view, `[h, w, c]`, any unit; its size may differ from the disparity's.
        disparity: Disparity of this view, `[y, x]`, px per view step, larger is nearer. A value
            that is not finite is sampled as zero and reported as not inside.
        step: View steps `(s_x, s_y)` from this view to the other: `(u_c - u, v_c - v)` from the
            center view to view `(v, u)`, and `(u_a - u_b, v_a - v_b)` from view a to view b.

    Returns:
        The warped image, `[y, x, c]`, and `inside`, `[y, x]`: True where the sampled place lies
        between the centers of pixels of `image`. Differentiable with respect to `image`,
        `disparity` and `step`.

    Source: Thesis 7.1.4, the warping operator of Eq. 7.15.

    Example:
        >>> import jax.numpy as jnp
        >>> image = jnp.arange(6.0).reshape(1, 6, 1)
        >>> warped, inside = backward_warp(image, jnp.full((1, 6), 0.5), jnp.array([2.0, 0.0]))
        >>> warped[0, :, 0].tolist(), inside[0].tolist()
        ([1.0, 2.0, 3.0, 4.0, 5.0, 5.0], [True, True, True, True, True, False])
    """
    height, width = disparity.shape
    finite = jnp.isfinite(disparity)
    shift = jnp.where(finite, disparity, 0).astype(image.dtype)
    step = step.astype(image.dtype)
    x = jnp.arange(width, dtype=image.dtype)[None, :] + step[0] * shift
    y = jnp.arange(height, dtype=image.dtype)[:, None] + step[1] * shift
    inside = finite & (x >= 0) & (x <= image.shape[1] - 1) & (y >= 0) & (y <= image.shape[0] - 1)

    def channel(values: Float[Array, "h w"]) -> Float[Array, "y x"]:
        return jax.scipy.ndimage.map_coordinates(values, [y, x], order=1, mode="nearest")

    return jax.vmap(channel, in_axes=-1, out_axes=-1)(image), inside
