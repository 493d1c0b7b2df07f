"""What both superpixel methods of the thesis do: k-means of unsquared distances, filling."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

# Features that are compared with all centers at a time.
_BLOCK = 512
# Pixels that look around themselves at a time.
_CHUNK = 512


def weighted(
    place: Float[Array, "*n 2"],
    depth: Float[Array, "*n"],
    lab: Float[Array, "*n 3"],
    weights: tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]],
) -> Float[Array, "*n 6"]:
    """Features whose distance is the sum of those of place, depth and color, each weighted."""
    position, disparity, color = weights
    parts = [position * place, disparity * depth[..., None], color * lab]
    return jnp.concatenate(parts, axis=-1)


def scaled(disparity: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Disparities from 0 to 1."""
    low, high = jnp.min(disparity), jnp.max(disparity)
    return (disparity - low) / jnp.where(high > low, high - low, 1)


def seed_grid(height: int, width: int, size: int) -> tuple[Int[Array, " r"], Int[Array, " c"]]:
    """Rows and columns of seeds, `size` apart."""
    rows, columns = (
        (jnp.arange(max(n // size, 1)) * size + size // 2).clip(0, n - 1) for n in (height, width)
    )
    return rows, columns


def k_means(
    features: Float[Array, "n 6"], seeds: Float[Array, "k 6"], *, rounds: int
) -> Int[Array, " n"]:
    """Clusters features with all centers tried for each; the first of equals wins.

    Args:
        features: from `weighted`.
        seeds: first centers.
        rounds: of assignment.

    Returns:
        The center of each, from 0 on.
    """
    count = features.shape[0]
    blocks = jnp.pad(features, ((0, -count % _BLOCK), (0, 0))).reshape(-1, _BLOCK, 6)

    def nearest(centers: Array) -> Array:
        def block(some: Array) -> Array:
            away = (some[:, None] - centers[None]) ** 2
            place, color = jnp.sum(away[..., :2], axis=-1), jnp.sum(away[..., 3:], axis=-1)
            distance = jnp.sqrt(place) + jnp.sqrt(away[..., 2]) + jnp.sqrt(color)
            return jnp.argmin(distance, axis=1).astype(jnp.int32)

        return lax.map(block, blocks).ravel()[:count]

    values = jnp.concatenate([features, jnp.ones_like(features[:, :1])], axis=-1)

    def update(centers: Array, _) -> tuple[Array, None]:
        sums = jnp.zeros((centers.shape[0], 7), features.dtype).at[nearest(centers)].add(values)
        mass = sums[:, 6:]
        # A cluster without members is as far away as can be, for good.
        return jnp.where(mass > 0, sums[:, :6] / jnp.where(mass > 0, mass, 1), jnp.inf), None

    centers, _ = lax.scan(update, seeds, length=rounds - 1)
    return nearest(centers)


def alike(
    known: Bool[Array, "y x"],
    lab: Float[Array, "y x 3"],
    place: Float[Array, ""],
    color: Float[Array, ""],
    *,
    radius: int,
) -> Int[Array, "y x"]:
    """The known pixel near every other one that is closest in place and color, both squared.

    Args:
        known: pixels to look at.
        lab: colors.
        place: weight of the squared distance, px.
        color: weight of the squared difference of color.
        radius: of the square window, px.

    Returns:
        Its flat index; the own one for known pixels; -1 where none is near.
    """
    height, width = known.shape
    size = height * width
    count = jnp.sum(~known, dtype=jnp.int32)
    (index,) = jnp.nonzero(~known.ravel(), size=size + _CHUNK, fill_value=size)
    index = index.astype(jnp.int32)
    reach = jnp.arange(-radius, radius + 1, dtype=jnp.int32)
    dy, dx = (a.ravel() for a in jnp.meshgrid(reach, reach, indexing="ij"))
    far = place * (dy**2 + dx**2).astype(lab.dtype)
    flat, use = lab.reshape(-1, 3), known.ravel()

    def some(state: tuple[Array, Array]) -> tuple[Array, Array]:
        start, source = state
        own = lax.dynamic_slice(index, (start,), (_CHUNK,))
        row, column = own[None] // width + dy[:, None], own[None] % width + dx[:, None]
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        other = jnp.where(inside, row * width + column, 0)
        away = jnp.sum((flat[jnp.minimum(own, size - 1)][None] - flat[other]) ** 2, axis=-1)
        cost = jnp.where(inside & use[other], far[:, None] + color * away, jnp.inf)
        best = jnp.argmin(cost, axis=0)
        found = jnp.where(jnp.isfinite(jnp.min(cost, axis=0)), other[best, jnp.arange(_CHUNK)], -1)
        return start + _CHUNK, source.at[own].set(found, mode="drop")

    start = jnp.asarray(0, jnp.int32), jnp.arange(size, dtype=jnp.int32)
    _, source = lax.while_loop(lambda state: state[0] < count, some, start)
    return source.reshape(known.shape)
