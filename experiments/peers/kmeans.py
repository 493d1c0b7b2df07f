"""k-means of the center view's pixels, moved to all views: the thesis' baseline (5.2.2)."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from mvedge_jax._compiler import lean_jit
from mvedge_jax._params import at_least, cast, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

from ._clustering import alike, k_means, scaled, seed_grid, weighted


class KMeansParams(eqx.Module):
    """Weights of `kmeans_superpixels`, each traced.

    Attributes:
        position: of a distance in the center view, per px.
        disparity: of all of the disparity range.
        color: of a difference of color, per unit of CIE Lab.
        fill: of a squared difference of color where holes are filled, per square px.
    """

    position: Float[Array, ""] = number(1.0, "per px")
    disparity: Float[Array, ""] = number(120.0, "per range")
    color: Float[Array, ""] = number(2.0, "per Lab")
    fill: Float[Array, ""] = number(400.0, "square px per Lab²")


@dataclass(frozen=True)
class KMeansSizes:
    """Static sizes of `kmeans_superpixels`.

    Attributes:
        size: side of the cells of the grid of seeds, px.
        rounds: of k-means.
        radius: how far holes are filled from, px.
    """

    size: int = 20
    rounds: int = 10
    radius: int = 20

    def __post_init__(self) -> None:
        at_least(self, size=1, rounds=1, radius=1)


@lean_jit
def kmeans_superpixels(
    light_field: LightField,
    disparity: Float[Array, "y x"],
    params: KMeansParams,
    sizes: KMeansSizes,
) -> Int[Array, "v u y x"]:
    """Clusters the pixels of the center view by place, disparity and color; the baseline of Ch. 5.

    A pixel belongs to the cluster with the least sum of weighted distances, not squared ones, of
    all; labels may have many pieces. Each pixel then goes to the up to four whole pixels around its
    place in a view, the nearest surface wins, and holes take the label of the pixel near them that
    is closest in place and color.

    Args:
        light_field: the views.
        disparity: of the center view, px per view step.
        params: weights.
        sizes: see `KMeansSizes`.

    Returns:
        Labels of all views, from 1 on; 0 where nothing is near. Not differentiable.

    Raises:
        ValueError: if the map has another size than the views.

    Source: Thesis 5.2.2. What leaves a view is dropped, and disparities are scaled to 0..1, which
        the authors' program does only where some are negative.

    Example:
        >>> light_field = LightField(jnp.full((1, 3, 20, 20, 3), 0.5))
        >>> sizes = KMeansSizes(size=10)
        >>> labels = kmeans_superpixels(light_field, jnp.zeros((20, 20)), KMeansParams(), sizes)
        >>> labels[0, 2, 0, ::10].tolist()
        [1, 2]
    """
    shape = light_field.views.shape[2:4]
    if disparity.shape != shape:
        raise ValueError(
            f"`disparity` must have the size of the views, {shape[0]}x{shape[1]}, got "
            f"{disparity.shape}."
        )
    params = cast(params, light_field.views.dtype)
    disparity = disparity.astype(light_field.views.dtype)
    labels = _clusters(srgb_to_lab(light_field.center_view), disparity, params, sizes)
    grid = light_field.available.size

    def one(item: tuple[Array, Array]) -> Array:
        view, step = item
        moved = _moved(labels, disparity, step)
        one = jnp.ones_like(params.fill)
        source = alike(moved > 0, srgb_to_lab(view), one, params.fill, radius=sizes.radius)
        return jnp.where(source < 0, 0, moved.ravel()[source])

    views = light_field.views.reshape(grid, *light_field.views.shape[2:])
    maps = lax.map(one, (views, light_field.steps.reshape(grid, 2)))
    return maps.reshape(light_field.views.shape[:4]).at[light_field.center].set(labels)


def _clusters(lab: Array, disparity: Array, params: KMeansParams, sizes: KMeansSizes) -> Array:
    """k-means of the pixels of the center view."""
    y, x = (a.astype(disparity.dtype) for a in jnp.indices(disparity.shape))
    weights = params.position, params.disparity, params.color
    features = weighted(jnp.stack([x, y], axis=-1), scaled(disparity), lab, weights)
    height, width = disparity.shape
    rows, columns = seed_grid(height, width, sizes.size)
    seeds = features[rows[:, None], columns[None]].reshape(-1, 6)
    found = k_means(features.reshape(-1, 6), seeds, rounds=sizes.rounds)
    return 1 + found.reshape(disparity.shape)


def _moved(labels: Array, disparity: Array, step: Array) -> Array:
    """Labels at the up to four pixels of a view around each place, nearest surface first."""
    height, width = labels.shape
    dtype = disparity.dtype
    x = jnp.arange(width, dtype=dtype)[None] + step[0] * disparity
    y = jnp.arange(height, dtype=dtype)[:, None] + step[1] * disparity
    places = []
    for row in (jnp.floor(y), jnp.ceil(y)):
        for column in (jnp.floor(x), jnp.ceil(x)):
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            index = row.astype(jnp.int32) * width + column.astype(jnp.int32)
            places.append(jnp.where(inside, index, height * width))
    place = jnp.stack(places)
    near = jnp.full(height * width + 1, -jnp.inf, dtype).at[place].max(disparity[None])
    wins = jnp.where(disparity[None] == near[place], labels[None], 0)
    return jnp.zeros(height * width + 1, jnp.int32).at[place].max(wins)[:-1].reshape(labels.shape)
