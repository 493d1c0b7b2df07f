"""Depth of every view as the thesis has it: projection, angular diffusion, projection again."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._compiler import lean_jit
from mvedge_jax._crosshair import view_steps
from mvedge_jax._params import cast, number
from mvedge_jax.color import srgb_to_gray, srgb_to_lab
from mvedge_jax.diffusion import AutoSolver, System, diffuse, edge_weights
from mvedge_jax.edges import EdgePoints, rasterize
from mvedge_jax.edges.sides import DirectionalDiffusion, bidirectional, thesis_response
from mvedge_jax.image import box_mean, convolved, gaussian
from mvedge_jax.lightfield import LightField
from mvedge_jax.warping import forward_warp

# Data weights of (6.8): of projected labels, and, the authors', of the center view's own.
_PROJECTED, _OWN = 15.0, 5.0
# Smoothness (6.7), of squared gradients of L in 0..100 under Sobel's filter.
_SCALE, _FLOOR = 0.1, 1e-5
# The authors' diffusion of off-crosshair views: data weight per projection, and its smoothness.
_JOINED, _JOINED_SCALE, _JOINED_FLOOR = 15000.0, 1e-3, 1e-7
# Blur before gradients, px.
_BLUR, _BLUR_REACH = 0.85, 2
_TOLERANCE = 1e-4


class Guiding(eqx.Module):
    r"""Weights $e^{\min(a \lambda_e, l)}$ of the lines of hidden points.

    Attributes:
        diffusion: the two directional solves that $\lambda_e$ comes from.
        gain: $a$, of the depth-edge confidence.
        limit: $l$, the largest exponent; the thesis' weight is unbounded.
    """

    diffusion: DirectionalDiffusion = eqx.field(default_factory=DirectionalDiffusion)
    gain: Float[Array, ""] = number(3.0, "1/px")
    limit: Float[Array, ""] = number(4.0)


@lean_jit
def thesis_views(
    light_field: LightField,
    disparity: Float[Array, "y x"],
    points: EdgePoints,
    params: Guiding,
) -> Float[Array, "v u y x"]:
    r"""Disparity of every view by the thesis' angular diffusion: the baseline of `depth_of_views`.

    The center view's map is projected into the views of the crosshair. In every epipolar-plane
    image, what it does not reach is diffused (6.4)-(6.7) from it and from the lines of points that
    the center view does not show, with $\lambda_d = 15$ and $e^{a \lambda_e}$ (6.8). A view beside
    the crosshair is the mean of the projections of the two crosshair views in its row and column;
    what neither reaches is diffused.

    The weight of the center row and the last diffusion are the authors', where the thesis is
    silent. Not kept are their shift of views by one, labels smeared along the border by lines that
    leave the frame, and holes taken for disparity 0. The center view keeps its map.

    Args:
        light_field: all views that are there; ground truth is not read.
        disparity: of the center view, sharpened, px per view step.
        points: of `ThesisEdges`, hidden ones among them; those of `OrientedEdges` are all seen in
            the center view, and leave the diffusion without guides.
        params: of the guides' weights.

    Returns:
        Maps of all views. Differentiable in views, map, points and parameters; which pixel goes
        where is a selection.

    Raises:
        ValueError: the map has another size than the views, or the points another crosshair.

    Source: Thesis 6.1, Eq. 6.4-6.8 (squared gradient).

    Example:
        >>> from mvedge_jax import EdgeDepth, multiview_edges
        >>> flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
        >>> points = multiview_edges(flat, EdgeDepth.for_light_field(flat)).points
        >>> thesis_views(flat, jnp.full((16, 16), 0.5), points, Guiding())[0, 2, 8, 8].item()
        0.5
    """
    rows, columns, height, width = light_field.views.shape[:4]
    if disparity.shape != (height, width):
        raise ValueError(
            f"`disparity` must have the size of the views, {height}x{width}, got {disparity.shape}."
        )
    if points.visible.shape[1] != rows + columns:
        raise ValueError(
            f"`points.visible` must tell of {rows + columns} views, the vertical arm first, got "
            f"{points.visible.shape[1]}."
        )
    params = cast(params, light_field.views.dtype)
    guides = _guides(light_field, points, params)
    vc, uc = light_field.center
    across = _of_arm(light_field.horizontal_arm, disparity, guides.of(rows, columns))
    turned = guides.of(0, rows).turned()
    down = _of_arm(jnp.swapaxes(light_field.vertical_arm, 1, 2), disparity.T, turned)
    down = jnp.swapaxes(down, 1, 2)

    def beside(item: tuple[Array, ...]) -> Array:
        picture, step, place = item
        right, below = jnp.diag(step)
        pair = (across[place % columns], below), (down[place // columns], right)
        return _joined(pair, picture)

    grid = rows * columns
    items = (
        light_field.views.reshape(grid, height, width, -1),
        light_field.steps.reshape(grid, 2),
        jnp.arange(grid, dtype=jnp.int32),
    )
    maps = lax.map(beside, items).reshape(rows, columns, height, width)
    return maps.at[vc].set(across).at[:, uc].set(down).at[vc, uc].set(disparity)


class _Guides(eqx.Module):
    """Points that the center view does not show, and the weights of their lines."""

    xy: Float[Array, "n 2"]
    disparity: Float[Array, " n"]
    weight: Float[Array, " n"]
    shown: Bool[Array, "n s"]

    def of(self, first: int, count: int) -> "_Guides":
        """The same with the views of one arm."""
        return _Guides(self.xy, self.disparity, self.weight, self.shown[:, first : first + count])

    def turned(self) -> "_Guides":
        """The same with x and y swapped."""
        return _Guides(self.xy[:, ::-1], self.disparity, self.weight, self.shown)


def _guides(light_field: LightField, points: EdgePoints, params: Guiding) -> _Guides:
    rows = light_field.views.shape[0]
    vc, uc = light_field.center
    hidden = ~(points.visible[:, vc] & points.visible[:, rows + uc])
    gray = srgb_to_gray(light_field.center_view)
    passes = bidirectional(points, gray, params.diffusion, respond=thesis_response)
    weight = jnp.exp(jnp.minimum(params.gain * passes.confidence, params.limit))
    shown = points.visible & (points.valid & hidden)[:, None]
    return _Guides(points.xy, points.disparity, weight, shown)


def _of_arm(
    arm: Float[Array, "s y x c"], disparity: Float[Array, "y x"], guides: _Guides
) -> Float[Array, "s y x"]:
    """Maps of the views of an arm, whose epipolar axis is x."""
    count, height, width = arm.shape[:3]
    steps = view_steps(count, disparity.dtype)

    def labeled(item: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        step, shown, own = item
        moved = forward_warp(disparity[..., None], disparity, jnp.stack([step, 0 * step]))
        # A pixel that none beside it joins is noise.
        beside = convolved(moved.hit.astype(disparity.dtype), jnp.ones(3, disparity.dtype), 1)
        trusted = jnp.where(own, _OWN, _PROJECTED).astype(disparity.dtype)
        weight = jnp.where(moved.hit & (beside > 1.5), trusted, 0)
        place = guides.xy + jnp.stack([step * guides.disparity, 0 * guides.disparity], axis=-1)
        raster = rasterize(place, guides.disparity, shown, (height, width))
        label = jnp.where(raster.hit, raster.values(guides.disparity), moved.image[..., 0])
        return label, jnp.where(raster.hit, raster.values(guides.weight), weight)

    middle = jnp.arange(count) == count // 2
    label, weight = lax.map(labeled, (steps, guides.shown.T, middle))
    light = srgb_to_lab(arm)[..., 0]
    light = gaussian(light, jnp.asarray(_BLUR, light.dtype), _BLUR_REACH)

    def solve(label: Array, weight: Array, light: Array) -> Array:
        tx, ty = edge_weights(_SCALE / (_sobel_square(light) + _FLOOR))
        solver = AutoSolver(tolerance=jnp.asarray(_TOLERANCE, label.dtype))
        return diffuse(System(weight, label, tx, ty), solver=solver).value

    found = jax.vmap(solve, in_axes=1, out_axes=1)(label, weight, light)
    return found.at[count // 2].set(disparity)


def _joined(
    pair: tuple[tuple[Array, Array], ...], picture: Float[Array, "y x c"]
) -> Float[Array, "y x"]:
    """Mean of two views' maps projected into a third, diffused where neither reaches."""
    total = count = jnp.zeros(picture.shape[:2], picture.dtype)
    for disparity, step in pair:
        moved = forward_warp(disparity[..., None], disparity, step)
        # The median over 3x3 pixels.
        known = moved.hit & (box_mean(moved.hit.astype(disparity.dtype), 1) > 0.5)
        total = total + jnp.where(known, moved.image[..., 0], 0)
        count = count + known.astype(disparity.dtype)
    label = total / jnp.maximum(count, 1)
    light = srgb_to_lab(picture)[..., 0]
    tx, ty = edge_weights(_JOINED_SCALE / (_sobel_square(light) + _JOINED_FLOOR))
    solver = AutoSolver(tolerance=jnp.asarray(_TOLERANCE, label.dtype))
    return diffuse(System(_JOINED * count, label, tx, ty), solver=solver).value


def _sobel_square(image: Float[Array, "y x"]) -> Float[Array, "y x"]:
    """Squared magnitude of the gradient by Sobel's filter, which counts it eight times."""
    smooth = jnp.asarray([1, 2, 1], image.dtype)
    slope = jnp.asarray([-1, 0, 1], image.dtype)
    across = convolved(convolved(image, smooth, 0), slope, 1)
    down = convolved(convolved(image, smooth, 1), slope, 0)
    return across**2 + down**2
