"""Soft superpixels with gradients (superpixel sampling networks)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax._checkpoint import checkpoint
from mvedge_jax._checks import checked_jit
from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import cast
from mvedge_jax.all_views import ViewDepths
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from ._clustering import SuperpixelClustering, validate
from ._clusters import (
    Clusters,
    Grid,
    Surface,
    cell_of,
    cell_offsets,
    distance,
    grid_over,
    means,
    seeded,
    surface_of,
    updated,
)
from ._superpixels import check_depths


class SoftSuperpixels(NamedTuple):
    """Shares of each pixel of the center view in superpixels.

    Attributes:
        shares: shares of the superpixels of the nine cells around a pixel; they sum to 1.
        names: indices of these superpixels, from 0 on; 0 with a share of 0 beyond the frame.
        xy: mean position of each superpixel in use, px.
        lab: mean color, CIELAB.
        plane: disparity at `xy`, px per view step, and its change per px along x and y.
        number: number of superpixels; later rows are not in use.
    """

    shares: Float[Array, "9 y x"]
    names: Int[Array, "9 y x"]
    xy: Float[Array, "k 2"]
    lab: Float[Array, "k 3"]
    plane: Float[Array, "k 3"]
    number: Int[Array, ""]


@checked_jit(validate)
def soft_superpixels(
    light_field: LightField, depths: ViewDepths, model: SuperpixelClustering
) -> SoftSuperpixels:
    r"""Assigns pixels of the center view to the clusters of `superpixels` by shares.

    A pixel p belongs to cluster k of the nine cells around it with the share
    $\exp(-D_k(p) / T) / \sum_j \exp(-D_j(p) / T)$, D the distance that `superpixels` measures and T
    the temperature; clusters are means with these shares, `model.rounds` times. There are no
    contours, no connected pieces and no search for a number: cells have `model.size`.

    Args:
        light_field: the center view is read.
        depths: the center view's disparity is read.
        model: see `SuperpixelClustering`; `margin` and `attempts` are not read. Gradients reach
            `color`, `depth`, `limit`, `slope` and `temperature`.

    Returns:
        Shares, clusters. Differentiable in the views, the disparity and the model, except for the
        grid of cells. Reverse mode only stores the clusters of every round.

    Raises:
        ValueError, TypeError: as `superpixels`.

    Source: superpixel sampling networks (Jampani et al.), with planes.

    Example:
        >>> flat = jnp.zeros((1, 3, 20, 20))
        >>> depths = ViewDepths(flat, flat, flat.astype(jnp.int8), jnp.asarray(0))
        >>> model = SuperpixelClustering.for_depths(depths).replace(size=10.0)
        >>> light_field = LightField(jnp.full((1, 3, 20, 20, 3), 0.5))
        >>> found = soft_superpixels(light_field, depths, model)
        >>> int(found.number), found.shares.sum(0).max().round(4).item()
        (4, 1.0)
    """
    check_depths(light_field, depths)
    dtype = light_field.views.dtype
    model = cast(model, dtype)
    disparity = depths.disparity[light_field.center].astype(dtype)
    surface = surface_of(srgb_to_lab(light_field.center_view), disparity, model.step)
    shape = light_field.views.shape[2], light_field.views.shape[3]
    grid = grid_over(shape, lax.stop_gradient(model.size), model.capacity)

    def one(clusters: Clusters, _) -> tuple[Clusters, None]:
        shares, names = _shares(surface, grid, clusters, model)

        def add(sums: Array, item: tuple[Array, Array]) -> tuple[Array, None]:
            return sums + updated(surface, clusters, *item, model), None

        nothing = jnp.zeros((model.capacity, 15), dtype)
        sums, _ = lax.scan(checkpoint(add), nothing, (shares, names))
        return means(clusters, sums, model), None

    start = seeded(surface, grid, model.capacity)
    clusters, _ = lax.scan(checkpoint(one), start, length=model.rounds)
    return SoftSuperpixels(
        *_shares(surface, grid, clusters, model), *clusters, grid.rows * grid.columns
    )


def _shares(
    surface: Surface, grid: Grid, clusters: Clusters, model: SuperpixelClustering
) -> tuple[Array, Array]:
    def cost(offset: Array) -> tuple[Array, Array]:
        which, inside = cell_of(grid, offset)
        found = distance(surface, clusters, which, grid.size, model)
        return jnp.where(inside, -found / model.temperature, -jnp.inf), which

    scores, names = lax.map(checkpoint(cost), cell_offsets())
    return jax.nn.softmax(scores, axis=0), names


@lean_jit
def through_superpixels(
    soft: SoftSuperpixels, image: Float[Array, "y x c"]
) -> Float[Array, "y x c"]:
    """Averages an image over soft superpixels and maps the means back to pixels.

    Args:
        soft: soft superpixels of the center view.
        image: values of the center view's size.

    Returns:
        The image, each pixel the mean of its superpixels' means. Differentiable in both; its
        difference from the image is a loss for learning superpixels.

    Example:
        >>> shares, names = jnp.full((9, 1, 2), 1 / 9), jnp.zeros((9, 1, 2), int)
        >>> one = jnp.ones((1, 3))
        >>> soft = SoftSuperpixels(shares, names, one[:, :2], one, one, jnp.array(1))
        >>> through_superpixels(soft, jnp.array([[[1.0], [3.0]]])).tolist()
        [[[2.0], [2.0]]]
    """
    ones = jnp.ones_like(image[..., :1])
    values = jnp.concatenate([image, ones], axis=-1)
    sums = jnp.zeros((soft.xy.shape[0], values.shape[-1]), values.dtype)
    sums = sums.at[soft.names].add(soft.shares[..., None] * values[None])
    mass = sums[:, -1:]
    mean = sums[:, :-1] / jnp.where(mass > 0, mass, 1)
    return jnp.sum(soft.shares[..., None] * mean[soft.names], axis=0)
