"""Edits of a light field with correct occlusion in every view (Thesis 6.7).

Every function takes the views with the disparity of all of them (`depth_of_views`) and returns a
light field without ground truth. Unedited pixels keep their exact values.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._checkpoint import checkpoint
from mvedge_jax._compiler import lean_jit
from mvedge_jax.image import box_mean
from mvedge_jax.interpolation import sample
from mvedge_jax.lightfield import LightField
from mvedge_jax.warping import holes

# Surfaces that differ by less than this, px per view step, are one.
_SAME = 0.1


@lean_jit
def insert_picture(
    light_field: LightField,
    disparities: Float[Array, "v u y x"],
    picture: Float[Array, "h w 4"],
    *,
    at: tuple[float, float] | Float[Array, "2"],
    disparity: float | Float[Array, ""],
    slant: tuple[float, float] | Float[Array, "2"] = (0.0, 0.0),
) -> LightField:
    r"""Puts a picture on a plane into the scene.

    In the center view, the plane has the disparity $d(q) = d_0 + a \cdot q$ at q from the place of
    the picture's middle. View s shows that point at $q + s\,d(q)$ from there.

    Args:
        light_field: the views, sRGB.
        disparities: maps of all views, px per view step; nearer surfaces hide the picture.
        picture: sRGB and alpha, in [0, 1], one pixel of it to a pixel of the center view.
        at: `(x, y)` of its middle in the center view, px.
        disparity: of its middle, px per view step.
        slant: change of the disparity per px along x and y; must leave the plane seen from its
            front in all views.

    Returns:
        The edited light field. Differentiable in views, picture, place and disparity; which is in
        front is a selection.

    Example:
        >>> import jax.numpy as jnp
        >>> field = LightField(jnp.zeros((3, 3, 9, 9, 3)))
        >>> card = jnp.ones((3, 3, 4))
        >>> depth = jnp.zeros((3, 3, 9, 9))
        >>> edited = insert_picture(field, depth, card, at=(4.0, 4.0), disparity=1.0)
        >>> edited.views[1, 0, 4, :, 0].tolist()
        [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0]
    """
    dtype = light_field.views.dtype
    place, tilt = jnp.asarray(at, dtype), jnp.asarray(slant, dtype)
    middle, picture = jnp.asarray(disparity, dtype), picture.astype(dtype)
    height, width = light_field.views.shape[2:4]
    # So that colors do not bleed in from transparent pixels.
    opaque = jnp.concatenate([picture[..., :3] * picture[..., 3:], picture[..., 3:]], axis=-1)

    def one(item: tuple[Array, Array, Array]) -> Array:
        view, depth, step = item
        x = jnp.arange(width, dtype=dtype)[None] - place[0] - step[0] * middle
        y = jnp.arange(height, dtype=dtype)[:, None] - place[1] - step[1] * middle
        # Where the plane shows: q + s (a q) = r, solved for q.
        along = (tilt[0] * x + tilt[1] * y) / (1 + tilt[0] * step[0] + tilt[1] * step[1])
        x, y = x - step[0] * along, y - step[1] * along
        x, y = x + 0.5 * (picture.shape[1] - 1), y + 0.5 * (picture.shape[0] - 1)
        shown = _between(opaque, x, y, beyond="constant")
        shown = jnp.where((middle + along > depth)[..., None], shown, 0)
        return shown[..., :3] + (1 - shown[..., 3:]) * view

    return _edited(light_field, _each(one, light_field, disparities))


@lean_jit
def paint(
    light_field: LightField,
    disparities: Float[Array, "v u y x"],
    mask: Float[Array, "y x"],
    color: Float[Array, "3"] | Float[Array, "y x 3"],
    *,
    shaded: bool = True,
) -> LightField:
    """Recolors a surface of the center view in every view that sees it.

    Where the center view does not show a surface, its paint goes on from what is seen of it in the
    same row or column, the farthest if several are.

    Args:
        light_field: the views, sRGB.
        disparities: of all views, px per view step.
        mask: how far each pixel of the center view is painted, 0..1.
        color: sRGB, one or a picture of the center view's size.
        shaded: keep the brightness of the surface relative to its mean under the mask, and so its
            texture and shading.

    Returns:
        The edited light field. Differentiable in views, mask and color.
    """
    dtype = light_field.views.dtype
    vc, uc = light_field.center
    center = light_field.center_view
    paint_on, mask = jnp.broadcast_to(color.astype(dtype), center.shape), mask.astype(dtype)
    total = jnp.maximum(jnp.sum(mask), jnp.finfo(dtype).tiny)
    mean = jnp.maximum(jnp.sum(mask * jnp.mean(center, axis=-1)) / total, 1e-3)
    layers = jnp.concatenate([paint_on, mask[..., None]], axis=-1)

    def one(item: tuple[Array, Array, Array]) -> Array:
        view, depth, step = item
        x, y = _in_center(depth, step)
        seen = _shows(disparities[vc, uc], depth, x, y)
        # What the center view does not show is painted as the same surface is beside it.
        beside = holes(depth, seen).behind
        goes_on = jnp.abs(depth.ravel()[beside] - depth) < _SAME
        place, _ = _nearest(x, y)
        whole = layers.reshape(-1, 4)[place.ravel()[beside]]
        shown = jnp.where(seen[..., None], _between(layers, x, y, beyond="edge"), whole)
        weight = jnp.where(goes_on, shown[..., 3], 0)[..., None]
        bright = jnp.mean(view, axis=-1, keepdims=True) / mean if shaded else 1
        painted = jnp.clip(shown[..., :3] * bright, 0, 1)
        return weight * painted + (1 - weight) * view

    return _edited(light_field, _each(one, light_field, disparities))


@lean_jit
def remove(
    light_field: LightField,
    disparities: Float[Array, "v u y x"],
    mask: Bool[Array, "y x"],
    *,
    radius: int = 0,
) -> LightField:
    """Removes a foreground layer of the center view, and shows what other views saw behind it.

    In every view, what the mask marks gives way to the surface behind it, continued from around.
    Its colors are those of the nearest view that sees it; where none does, those of the
    surroundings.

    Args:
        light_field: the views, sRGB.
        disparities: of all views, px per view step.
        mask: pixels of the center view to remove.
        radius: how far around them, in every view, pixels blend with them and go, too, px.

    Returns:
        The edited light field. Differentiable in the views.
    """
    vc, uc = light_field.center
    rows, columns, height, width = disparities.shape
    center = disparities[vc, uc]
    steps = light_field.steps.reshape(-1, 2)
    dtype = light_field.views.dtype

    def marked(depth: Array, step: Array) -> Array:
        x, y = _in_center(depth, step)
        there = _between(mask[..., None].astype(dtype), x, y, beyond="edge")[..., 0] > 0
        return margin(there & _shows(center, depth, x, y), radius=radius)

    maps = disparities.reshape(-1, height, width)
    gone = lax.map(lambda item: marked(*item), (maps, steps))
    views = light_field.views.reshape(-1, height, width, 3)
    sources = jnp.arange(rows * columns)

    def one(item: tuple[Array, ...]) -> Array:
        view, depth, step, out = item
        behind = holes(depth, ~out).behind
        deeper = depth.ravel()[behind]
        # At first what is around, then the views from far to near: the nearest has the last word.
        around = view.reshape(-1, 3)[behind]
        order = jnp.argsort(-jnp.sum((steps - step[None]) ** 2, axis=1))

        def seen_by(color: Array, which: Array) -> tuple[Array, None]:
            other = steps[which] - step
            x = jnp.arange(width, dtype=dtype)[None] + other[0] * deeper
            y = jnp.arange(height, dtype=dtype)[:, None] + other[1] * deeper
            clear = _shows(jnp.where(gone[which], jnp.inf, maps[which]), deeper, x, y)
            clear = clear & light_field.available.ravel()[which]
            shown = _between(views[which], x, y, beyond="edge")
            return jnp.where(clear[..., None], shown, color), None

        color, _ = lax.scan(checkpoint(seen_by), around, sources[order])
        return jnp.where(out[..., None], color, view)

    shown = lax.map(checkpoint(one), (views, maps, steps, gone))
    return _edited(light_field, shown.reshape(light_field.views.shape))


def margin(mask: Bool[Array, "y x"], *, radius: int) -> Bool[Array, "y x"]:
    """A mask grown by some pixels.

    Args:
        mask: of a view.
        radius: px.

    Returns:
        Pixels within a square around any that is marked.
    """
    return box_mean(mask.astype(jnp.result_type(float)), radius) > 0


def _each(edit, light_field: LightField, disparities: Array) -> Array:
    views, grid = light_field.views, light_field.available.size
    items = (
        views.reshape(grid, *views.shape[2:]),
        disparities.reshape(grid, *views.shape[2:4]),
        light_field.steps.reshape(grid, 2),
    )
    return lax.map(edit, items).reshape(views.shape)


def _edited(light_field: LightField, views: Array) -> LightField:
    return eqx.tree_at(lambda field: field.views, light_field.without_truth(), views)


def _in_center(depth: Array, step: Array) -> tuple[Array, Array]:
    """Where the pixels of a view lie in the center view."""
    height, width = depth.shape
    x = jnp.arange(width, dtype=depth.dtype)[None] - step[0] * depth
    return x, jnp.arange(height, dtype=depth.dtype)[:, None] - step[1] * depth


def _shows(surface: Array, depth: Array, x: Array, y: Array) -> Array:
    """Whether a map has the surface of disparity `depth` at a place, by the nearest pixel."""
    index, inside = _nearest(x, y)
    return inside & (jnp.abs(surface.ravel()[index] - depth) < _SAME)


def _nearest(x: Array, y: Array) -> tuple[Array, Array]:
    """Flat index of the nearest pixel of an image of the same size, and whether there is one."""
    height, width = x.shape
    column, row = (lax.stop_gradient(jnp.floor(a + 0.5)) for a in (x, y))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return jnp.where(inside, row * width + column, 0).astype(jnp.int32), inside


def _between(
    image: Float[Array, "h w c"], x: Array, y: Array, *, beyond: str
) -> Float[Array, "y x c"]:
    """An image between its pixels; beyond them the border's (`"edge"`) or 0 (`"constant"`)."""
    ringed = jnp.pad(image, ((1, 1), (1, 1), (0, 0)), mode=beyond)
    xy = jnp.stack([x, y], axis=-1).reshape(-1, 2) + 1
    channels = [sample(ringed[..., c], xy).reshape(x.shape) for c in range(image.shape[-1])]
    return jnp.stack(channels, axis=-1)
