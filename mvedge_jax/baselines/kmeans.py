"""k-means of the centre view's pixels, moved to all views: the thesis' baseline (5.2.2)."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import at_least, cast, number
from mvedge_jax.color import srgb_to_lab
from mvedge_jax.lightfield import LightField

# Holes that are filled at a time.
_CHUNK = 512


class KMeansParams(eqx.Module):
    """Weights of `kmeans_superpixels`, each traced.

    Attributes:
        position: of a distance in the centre view, per px.
        disparity: of all of the disparity range.
        colour: of a difference of colour, per unit of CIE Lab.
        fill: of a squared difference of colour where holes are filled, per square px.
    """

    position: Float[Array, ""] = number(1.0, "per px")
    disparity: Float[Array, ""] = number(120.0, "per range")
    colour: Float[Array, ""] = number(2.0, "per Lab")
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


@eqx.filter_jit
def kmeans_superpixels(
    light_field: LightField,
    disparity: Float[Array, "y x"],
    params: KMeansParams,
    sizes: KMeansSizes,
) -> Int[Array, "v u y x"]:
    """Clusters the pixels of the centre view by place, disparity and colour; the baseline of Ch. 5.

    A pixel belongs to the cluster with the least sum of weighted distances, not squared ones, of
    all; labels may have many pieces. Each pixel then goes to the up to four whole pixels around its
    place in a view, the nearest surface wins, and holes take the label of the pixel near them that
    is closest in place and colour.

    Args:
        light_field: the views.
        disparity: of the centre view, px per view step.
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
    labels = _clusters(srgb_to_lab(light_field.centre_view), disparity, params, sizes)
    grid = light_field.available.size

    def one(item: tuple[Array, Array]) -> Array:
        view, step = item
        moved = _moved(labels, disparity, step)
        return _filled(moved, srgb_to_lab(view), params.fill, sizes.radius)

    views = light_field.views.reshape(grid, *light_field.views.shape[2:])
    maps = lax.map(one, (views, light_field.steps.reshape(grid, 2)))
    return maps.reshape(light_field.views.shape[:4]).at[light_field.centre].set(labels)


def _clusters(lab: Array, disparity: Array, params: KMeansParams, sizes: KMeansSizes) -> Array:
    """k-means with all centres tried for every pixel."""
    height, width = disparity.shape
    dtype = disparity.dtype
    low, high = jnp.min(disparity), jnp.max(disparity)
    depth = (disparity - low) / jnp.where(high > low, high - low, 1)
    y, x = (a.astype(dtype) for a in jnp.indices(disparity.shape))
    weight = jnp.stack([params.position] * 2 + [params.disparity] + [params.colour] * 3)
    features = weight[None, None] * jnp.concatenate(
        [jnp.stack([x, y, depth], axis=-1), lab], axis=-1
    )
    rows, columns = (
        (jnp.arange(max(n // sizes.size, 1)) * sizes.size + sizes.size // 2).clip(0, n - 1)
        for n in (height, width)
    )
    seeds = features[rows[:, None], columns[None]].reshape(-1, 6)

    def nearest(centres: Array) -> Array:
        def row(pixels: Array) -> Array:
            away = (pixels[:, None] - centres[None]) ** 2
            place, colour = jnp.sum(away[..., :2], axis=-1), jnp.sum(away[..., 3:], axis=-1)
            distance = jnp.sqrt(place) + jnp.sqrt(away[..., 2]) + jnp.sqrt(colour)
            return jnp.argmin(distance, axis=1).astype(jnp.int32)

        return lax.map(row, features)

    def update(centres: Array, _) -> tuple[Array, None]:
        label = nearest(centres)
        ones = jnp.ones_like(features[..., :1])
        values = jnp.concatenate([features, ones], axis=-1)
        sums = jnp.zeros((centres.shape[0], 7), dtype).at[label].add(values)
        mass = sums[:, 6:]
        # A cluster without pixels is as far away as can be, for good.
        return jnp.where(mass > 0, sums[:, :6] / jnp.where(mass > 0, mass, 1), jnp.inf), None

    centres, _ = lax.scan(update, seeds, length=sizes.rounds - 1)
    return 1 + nearest(centres)


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


def _filled(labels: Array, lab: Float[Array, "y x 3"], weight: Array, radius: int) -> Array:
    """Fills holes from the labels there are, some holes at a time."""
    height, width = labels.shape
    hole: Bool[Array, "y x"] = labels == 0
    count = jnp.sum(hole, dtype=jnp.int32)
    (index,) = jnp.nonzero(hole.ravel(), size=labels.size + _CHUNK, fill_value=labels.size)
    index = index.astype(jnp.int32)
    reach = jnp.arange(-radius, radius + 1, dtype=jnp.int32)
    dy, dx = (a.ravel() for a in jnp.meshgrid(reach, reach, indexing="ij"))
    far = (dy**2 + dx**2).astype(lab.dtype)
    flat, known = lab.reshape(-1, 3), labels.ravel()

    def some(state: tuple[Array, Array]) -> tuple[Array, Array]:
        start, filled = state
        own = lax.dynamic_slice(index, (start,), (_CHUNK,))
        row, column = own[None] // width + dy[:, None], own[None] % width + dx[:, None]
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        other = jnp.where(inside, row * width + column, 0)
        away = jnp.sum((flat[jnp.minimum(own, labels.size - 1)][None] - flat[other]) ** 2, axis=-1)
        cost = jnp.where(inside & (known[other] > 0), far[:, None] + weight * away, jnp.inf)
        best = jnp.argmin(cost, axis=0)
        label = known[other[best, jnp.arange(_CHUNK)]]
        found = jnp.where(jnp.isfinite(jnp.min(cost, axis=0)), label, 0)
        return start + _CHUNK, filled.at[own].set(found, mode="drop")

    start = jnp.asarray(0, jnp.int32), known
    _, filled = lax.while_loop(lambda state: state[0] < count, some, start)
    return filled.reshape(labels.shape)
