"""Costs of all hypotheses, with a transpose that skips hypotheses without cotangents.

A pixel's disparity usually depends on three of its hypotheses. A transpose over all of them, image
by image, takes several times the work of the costs. This one visits parts of the image, and in
each the hypotheses that have cotangents there.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._cpu import of_both
from mvedge_jax._linear_map import linear_map

from ._arm import Corner, Half, Limits, Swept, arm_cost, moved_cost, reach_of, shifted, shifted_to

# Side of a part, px; results do not depend on it. Smaller parts need fewer hypotheses, but have
# larger margins.
_PART = 64


class Sweep(NamedTuple):
    """Inputs of a volume of costs.

    Attributes:
        across: the horizontal arm.
        down: the vertical arm, transposed.
        disparities: px per view step.
        limits: see `Limits`.
    """

    across: Swept
    down: Swept
    disparities: Array
    limits: Limits


class _Region(NamedTuple):
    """A part of the image with its margin.

    Attributes:
        corner: first row and column of the part.
        wanted: cotangents of the costs of the part; 0 around it, `[d, y, x]`.
        local: center view, weights and share of drift there.
    """

    corner: Corner
    wanted: Array
    local: tuple[Array, Array, Array, Array]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def volume(window: int, sweep: Sweep) -> Float[Array, "d y x"]:
    """The costs of all disparities over both arms.

    Args:
        window: half the width of the window of the cost, px.
        sweep: see `Sweep`.

    Returns:
        Costs, at most 2. Differentiable in both modes, and forwards once more.
    """
    del window
    return _costs(sweep)


@volume.defjvp
def _volume_jvp(window: int, primals: Any, tangents: Any) -> tuple[Array, Array]:
    def forward(fixed: Sweep, moving: Sweep) -> Array:
        return jax.jvp(_costs, (fixed,), (moving,))[1]

    (sweep,), (moving,) = primals, tangents
    return _costs(sweep), linear_map(forward, partial(_pulled, window), sweep, moving)


def _costs(sweep: Sweep) -> Array:
    def of_arm(arm: Swept) -> Array:
        @jax.checkpoint
        def cost(disparity: Array) -> Array:
            return arm_cost(arm, disparity, sweep.limits)

        return lax.map(cost, sweep.disparities)

    along_rows, along_columns = of_both(of_arm, sweep.across, sweep.down)
    return along_rows + jnp.swapaxes(along_columns, 1, 2)


def _pulled(window: int, sweep: Sweep, cotangent: Float[Array, "d y x"]) -> Sweep:
    """The transpose."""
    # One after the other: cotangents of both arms at once take several times the memory.
    across, along_x = _pulled_arm(window, sweep.across, sweep, cotangent)
    down, along_y = _pulled_arm(window, sweep.down, sweep, jnp.swapaxes(cotangent, 1, 2))
    return Sweep(across, down, *jax.tree.map(jnp.add, along_x, along_y))


def _pulled_arm(
    window: int, arm: Swept, sweep: Sweep, cotangent: Array
) -> tuple[Swept, tuple[Array, Limits]]:
    """Cotangents of an arm, and of disparities and limits."""
    reach = reach_of(window)
    shape = arm.center.shape[1:]
    part = [min(_PART, side) for side in shape]
    size = (min(part[0] + 2 * reach, shape[0]), min(part[1] + 2 * reach, shape[1]))
    across = -(-shape[1] // part[1])

    def visit(total: Any, index: Array) -> tuple[Any, None]:
        first = index // across * part[0], index % across * part[1]
        corner = (
            jnp.clip(first[0] - reach, 0, shape[0] - size[0]),
            jnp.clip(first[1] - reach, 0, shape[1] - size[1]),
        )
        wanted = jnp.where(_inside(first, part, corner, size), _cut(cotangent, corner, size), 0)
        counts = jnp.any(wanted != 0, axis=(1, 2))
        order = jnp.argsort(~counts)
        region = _Region(corner, wanted, jax.tree.map(lambda a: _cut(a, corner, size), local))

        def level(i: Array, state: Any) -> Any:
            return _level(order[i], region, arm, sweep, state)

        planes, whole, others = total
        here = jax.tree.map(jnp.zeros_like, region.local)
        count = jnp.sum(counts, dtype=jnp.int32)
        planes, here, others = lax.fori_loop(0, count, level, (planes, here, others))
        whole = jax.tree.map(lambda a, b: _added(a, b, corner), whole, here)
        return (planes, whole, others), None

    local = arm.center, arm.support, arm.wide, arm.share
    steps = tuple((half.steps, half.there) for half in arm.halves)
    start = (
        tuple(half.planes for half in arm.halves),
        local,
        (steps, (sweep.disparities, sweep.limits)),
    )
    parts = jnp.arange(-(-shape[0] // part[0]) * across, dtype=jnp.int32)
    total, _ = lax.scan(visit, jax.tree.map(jnp.zeros_like, start), parts)
    planes, (center, support, wide, share), (steps, numbers) = total
    before, after = (Half(p, *of) for p, of in zip(planes, steps, strict=True))
    return Swept(center, (before, after), support, wide, share), numbers


def _level(k: Array, region: _Region, arm: Swept, sweep: Sweep, state: Any) -> Any:
    """Adds the cotangents of one hypothesis in one part."""
    planes, here, (steps, (disparities, limits)) = state
    corner, disparity = region.corner, sweep.disparities[k]

    def cost(local: Any, moved: Any, of: Any, disparity: Array, limits: Limits) -> Array:
        center, support, wide, share = local
        before, after = (Half(h.planes, *s) for h, s in zip(arm.halves, of, strict=True))
        part = Swept(center, (before, after), support, wide, share)
        return moved_cost(part, moved, disparity, limits)

    size = region.wanted.shape[1], region.wanted.shape[2]
    moved = [shifted(half, disparity, corner, size) for half in arm.halves]
    of = tuple((half.steps, half.there) for half in arm.halves)
    _, pull = jax.vjp(cost, region.local, moved, of, disparity, sweep.limits)
    more, parts, more_of, slope, more_limits = pull(region.wanted[k])
    planes = tuple(
        _moved_back(plane, half, disparity, part, corner)
        for plane, half, part in zip(planes, arm.halves, parts, strict=True)
    )
    here, steps, limits = jax.tree.map(jnp.add, (here, steps, limits), (more, more_of, more_limits))
    return planes, here, (steps, (disparities.at[k].add(slope), limits))


def _moved_back(
    planes: Array, half: Half, disparity: Array, parts: list[Array], corner: Corner
) -> Array:
    """Adds cotangents of the shifted parts of a half's views to the whole planes."""
    for s, part in enumerate(parts):
        planes = _added(planes, part[None], shifted_to(half, disparity, s, corner))
    return planes


def _inside(
    first: Corner, part: list[int], corner: Corner, size: tuple[int, int]
) -> Bool[Array, "y x"]:
    """Pixels of a region that are in its part: regions overlap."""
    rows, columns = (
        (at >= 0) & (at < side)
        for at, side in (
            (jnp.arange(n, dtype=jnp.int32) + c - f, p)
            for n, c, f, p in zip(size, corner, first, part, strict=True)
        )
    )
    return rows[:, None] & columns[None]


def _cut(array: Array, corner: Corner, size: tuple[int, int]) -> Array:
    """A region of the last two axes."""
    return lax.dynamic_slice(array, _start(array, corner), array.shape[:-2] + size)


def _added(array: Array, region: Array, corner: Sequence[Array | int]) -> Array:
    """The array with a region added to it."""
    start = _start(array, corner)
    own = lax.dynamic_slice(array, start, region.shape)
    return lax.dynamic_update_slice(array, own + region, start)


def _start(array: Array, corner: Sequence[Array | int]) -> list[Array]:
    """The corner with zeros for the axes before its own."""
    missing = array.ndim - len(corner)
    return [jnp.asarray(at, jnp.int32) for at in (*missing * (0,), *corner)]
