"""Reprojection error: what a disparity map does to the colors (Appendix C.1, Tab. C.1)."""

from typing import Literal, NamedTuple

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mvedge_jax._params import accepts_numpy
from mvedge_jax._root import safe_sqrt
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField
from mvedge_jax.warping import backward_warp, visible

from ._region import check_crop, cropped

# What a pixel without a disparity is charged: the whole range of a channel, black against white.
_WORST = {"rgb": 1.0, "lab": 100.0}


class Reprojection(NamedTuple):
    """Color error between the center view and other views; see `reprojection_error`.

    Attributes:
        error: Mean over the target views: RGB x 100, or the color difference in Lab.
        per_view: The same per target view, `[t]`, in the order of `targets`.
        image: Mean over the target views that see the pixel, `[y, x]`, same unit; NaN where none.
        covered: Share of pixels that entered `per_view`, `[t]`.
    """

    error: Float[Array, ""]
    per_view: Float[Array, " t"]
    image: Float[Array, "y x"]
    covered: Float[Array, " t"]


@accepts_numpy
def reprojection_error(
    disparity: Float[Array, "y x"],
    light_field: LightField,
    *,
    space: Literal["rgb", "lab"] = "rgb",
    targets: tuple[tuple[int, int], ...] | None = None,
    crop: int = 0,
    tolerance: float | Float[Array, ""] = 1.0,
) -> Reprojection:
    r"""Color error of the center view moved to other views by its disparity map.

    Each pixel of the center view is compared with the color that the target view has where the
    disparity puts it (bilinear), if the target sees it (`warping.visible`). RGB: mean absolute
    difference of the channels of sRGB in [0, 1], x 100. Lab: Euclidean distance, CIE 1976
    $\Delta E$. A pixel whose disparity is not finite is charged 100 in either space.

    A proxy where there is no ground truth: a map may be wrong on plain surfaces without any error,
    and an exact map has an error at blurred depth edges, noise and highlights.

    Args:
        disparity: Disparity of the center view, `[y, x]`, px per view step.
        light_field: The views; its ground truth is not read.
        space: `rgb` (Tab. C.1) or `lab`, static.
        targets: Views `(v, u)` to compare with, static; by default the four corners.
        crop: Pixels of the center view to leave out on each side, static.
        tolerance: Parallax from which on a nearer pixel hides another, px in the target, traced.

    Returns:
        The error, per target view and per pixel. Differentiable with respect to `disparity` and
        the views, visibility being held fixed.

    Raises:
        ValueError: if shapes differ, the crop leaves nothing, or a target view is missing.

    Source: Thesis Appendix C.1, Tab. C.1.
    """
    rows, columns, *shape = light_field.views.shape[:4]
    if disparity.shape != tuple(shape):
        raise ValueError(
            f"`disparity` must have the size of the views, {tuple(shape)}, got {disparity.shape}."
        )
    check_crop((shape[0], shape[1]), crop)
    if space not in _WORST:
        raise ValueError(f"`space` must be 'rgb' or 'lab', got {space!r}.")
    if targets is None:
        corners = ((0, 0), (0, columns - 1), (rows - 1, 0), (rows - 1, columns - 1))
        targets = tuple(dict.fromkeys(corners))
    available = light_field.available
    for v, u in targets:
        there = 0 <= v < rows and 0 <= u < columns
        if there and not isinstance(available, jax.core.Tracer):
            there = bool(np.asarray(available)[v, u])
        if not there:
            raise ValueError(
                f"`targets` asks for view (v, u) = ({v}, {u}), which is not in this light field "
                f"({rows}x{columns} views, {space}); name views that are, for example the ends of "
                "the crosshair."
            )
    return _error(
        disparity, light_field, jnp.asarray(tolerance, disparity.dtype), space, targets, crop
    )


def _reprojection(disparity, light_field, tolerance, space, targets, crop) -> Reprojection:
    convert = srgb_to_lab if space == "lab" else (lambda image: image)
    center = convert(light_field.center_view)
    finite = jnp.isfinite(disparity)
    scale = 100 if space == "rgb" else 1

    def compare(target: Array) -> tuple[Array, Array]:
        step = light_field.steps[target[0], target[1]].astype(disparity.dtype)
        view = light_field.views[target[0], target[1]]
        warped, inside = backward_warp(convert(view), disparity, step)
        steps = jnp.maximum(jnp.abs(step).max(), 1)
        seen = inside & visible(disparity, step, tolerance=tolerance / steps)
        difference = warped - center
        if space == "rgb":
            distance = jnp.abs(difference).mean(-1)
        else:
            squares = (difference**2).sum(-1)
            distance = safe_sqrt(squares)
        distance = scale * jnp.where(finite, jnp.where(seen, distance, 0), _WORST[space])
        return cropped(distance, crop), cropped(seen | ~finite, crop)

    distance, counted = jax.lax.map(compare, jnp.asarray(targets, jnp.int32))
    number = counted.sum((1, 2), dtype=jnp.int32).astype(distance.dtype)
    per_view = distance.sum(2).sum(1) / number
    views = counted.sum(0, dtype=jnp.int32).astype(distance.dtype)
    image = jnp.where(views > 0, distance.sum(0) / jnp.maximum(views, 1), jnp.nan)
    return Reprojection(per_view.mean(), per_view, image, number / counted[0].size)


_error = jax.jit(_reprojection, static_argnames=("space", "targets", "crop"))
