"""Aggregation of matching costs along paths through the image."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from mvedge_jax._cpu import of_both
from mvedge_jax._root import safe_sqrt


def aggregate(
    cost: Float[Array, "d y x"],
    lab: Float[Array, "c y x"],
    *,
    slant: Float[Array, ""],
    jump: Float[Array, ""],
    color: Float[Array, ""],
    reach: int = 1,
) -> Float[Array, "d y x"]:
    r"""Sums, over four directions, the cost of the cheapest path that ends at each pixel.

    Along a path, a change by $i \le \mathrm{reach}$ disparities costs $i$ times `slant`, and any
    change costs at most $j = \mathrm{jump} / (1 + |\Delta Lab| / \mathrm{color})$:
    $L(p, d) = C(p, d) + \min(L(q, d), L(q, d \pm i) + i s, \min_k L(q, k) + j) - \min_k L(q, k)$
    with $q$ the pixel before $p$. Pixels without texture follow their surface, however far its
    texture is.

    Args:
        cost: per disparity and pixel, `[d, y, x]`.
        lab: center view in CIELAB, `[c, y, x]`.
        slant: penalty of a step to the next disparity, in units of `cost`.
        jump: penalty of any other step between pixels of the same color.
        color: step of CIELAB color that halves the penalty of a jump.
        reach: disparities of the largest step that `slant` prices.

    Returns:
        The sum, `[d, y, x]`.

    Source: not in the thesis; Hirschmueller (2008), "Stereo Processing by Semiglobal Matching".

    Example:
        >>> import jax.numpy as jnp
        >>> cost = jnp.ones((3, 1, 5)).at[2, 0, 0].set(0.0)
        >>> one = jnp.asarray(1.0)
        >>> total = aggregate(cost, jnp.zeros((3, 1, 5)), slant=one, jump=one, color=one)
        >>> total.argmin(0)[0].tolist()
        [2, 2, 2, 2, 2]
    """
    across, down = of_both(
        lambda of: _both_ways(*of, slant, jump, color, reach),
        (jnp.transpose(cost, (2, 0, 1)), jnp.transpose(lab, (2, 0, 1))),
        (jnp.transpose(cost, (1, 0, 2)), jnp.transpose(lab, (1, 0, 2))),
    )
    return jnp.transpose(down, (1, 0, 2)) + jnp.transpose(across, (1, 2, 0))


def _both_ways(
    cost: Array, lab: Array, slant: Array, jump: Array, color: Array, reach: int
) -> Array:
    """Paths along the first axis, in its direction and against it."""
    square = jnp.zeros_like(lab[1:, 0])
    for channel in range(lab.shape[1]):
        square = square + jnp.diff(lab[:, channel], axis=0) ** 2
    price = jump / (1 + safe_sqrt(square) / color)
    free = jnp.zeros_like(lab[:1, 0])
    wall = jnp.full_like(cost[0], jnp.inf)

    @jax.checkpoint
    def visit(before: Array, item: tuple[Array, Array]) -> tuple[Array, Array]:
        own, price = item
        least = _least(before)
        best = jnp.minimum(_sloped(before, wall, slant, reach), (least + price)[None])
        now = own + best - least[None]
        return now, now

    start = jnp.zeros_like(cost[0])
    forward = lax.scan(visit, start, (cost, jnp.concatenate([free, price])))[1]
    backward = lax.scan(visit, start, (cost, jnp.concatenate([price, free])), reverse=True)[1]
    return forward + backward


def _sloped(before: Array, wall: Array, slant: Array, reach: int) -> Array:
    """Least cost of a step by up to `reach` disparities, by steps of 1, 2, 4, ... of them."""
    done = 0
    while done < reach:
        step = min(done + 1, reach - done)
        beside = jnp.minimum(
            jnp.concatenate([before[step:], wall[:step]]),
            jnp.concatenate([wall[:step], before[:-step]]),
        )
        before = jnp.minimum(before, beside + step * slant)
        done += step
    return before


def _least(values: Array) -> Array:
    """Minimum over the first axis by halves: XLA on CPU vectorizes these, but no reduction."""
    count = values.shape[0]
    while count > 1:
        half = (count + 1) // 2
        values = jnp.minimum(values[:half], values[count - half :])
        count = half
    return values[0]
