"""Moves depth steps of a map to image edges, for points with inaccurate positions."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import as_number, cast, number
from mvedge_jax.color import planes_to_lab
from mvedge_jax.diffusion import System, diffuse
from mvedge_jax.model.approaches._evidence import _shrink
from mvedge_jax.smoothness import ColorAndDepth, edge_smoothness


def _image_alone() -> ColorAndDepth:
    color, color_power, depth_power = map(as_number, (0.5, 4.0, 0.0))
    return ColorAndDepth(color=color, color_power=color_power, depth_power=depth_power)


class StepRelocation(eqx.Module):
    """Parameters of the relocation of depth steps.

    Attributes:
        step: neighbors whose disparities differ by more than this are at a depth step, px.
        trust: data weight of pixels away from depth steps.
        smoothness: edge weights by image edges alone, where disparities may jump.
    """

    step: Float[Array, ""] = number(0.2)
    trust: Float[Array, ""] = number(1e4)
    smoothness: ColorAndDepth = eqx.field(default_factory=_image_alone)


@lean_jit
def relocate_steps(
    disparity: Float[Array, "y x"],
    image: Float[Array, "c y x"],
    params: StepRelocation,
    *,
    reach: int = 1,
) -> Float[Array, "y x"]:
    """Moves depth steps by up to `reach` pixels to where the image has an edge.

    Pixels near a depth step are discarded and diffused again from both sides, with a smoothness
    that follows the image alone. This corrects steps of points with noisy positions: on *cotton*,
    on which the defaults were chosen, with noise of 1 px, it removes 89 % of the mean squared
    error by the noise. Steps of `EdgeDepth`, which uses more than the image, get slightly worse.

    Args:
        disparity: the map, px per view step, finite.
        image: center view, sRGB in [0, 1].
        params: see `StepRelocation`.
        reach: distance from a step within which the map is discarded, px; static.

    Returns:
        The map; differentiable except for the positions of its steps.

    Raises:
        ValueError: the image has another size than the map, or `reach` is not positive.

    Example:
        >>> import jax.numpy as jnp
        >>> image = jnp.zeros((3, 5, 12)).at[:, :, 6:].set(1.0)
        >>> disparity = jnp.zeros((5, 12)).at[:, 7:].set(1.0)  # a pixel off
        >>> found = relocate_steps(disparity, image, StepRelocation())
        >>> found[2, 4:9].round(2).tolist()
        [0.0, 0.0, 1.0, 1.0, 1.0]
    """
    if image.shape[1:] != disparity.shape:
        raise ValueError(f"`image` has the shape {image.shape}; the map has {disparity.shape}.")
    if reach < 1:
        raise ValueError(f"`reach` must be at least 1 pixel, got {reach}.")
    params = cast(params, disparity.dtype)
    lab = planes_to_lab(image)
    # By first differences, because steps of noisy points are spread over pixels.
    clear = _clear(disparity, params.step) & _clear(disparity.T, params.step).T
    weight = jnp.where(_shrink(clear, reach - 1), params.trust, 0)
    # If all pixels are near steps, the map stays.
    weight = jnp.where(jnp.any(weight > 0), weight, params.trust)
    tx, ty = edge_smoothness(lab, disparity, params.smoothness)
    return diffuse(System(weight, disparity, tx, ty)).value


def _clear(disparity: Float[Array, "y x"], step: Array) -> Bool[Array, "y x"]:
    """Pixels that differ from their neighbors along x by less than a step."""
    same = jnp.abs(jnp.diff(disparity, axis=1)) < step
    same = jnp.pad(same, ((0, 0), (1, 1)), constant_values=True)
    return same[:, 1:] & same[:, :-1]
