"""Where rays meet solids, in closed form."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .world import Solids

Vector = tuple[Array, Array, Array]

_TINY = 1e-12
_LIFT = 2e-4  # where a shadow ray starts, relative to the distance


def dot(a: Vector, b: Vector) -> Array:
    """Scalar product of vectors that are kept by component."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def along(origin: Vector, direction: Vector, distance: Array) -> Vector:
    """`origin + distance * direction`."""
    x, y, z = (o + distance * d for o, d in zip(origin, direction, strict=True))
    return x, y, z


def rotate(axes: Array | np.ndarray, vector: Vector) -> Vector:
    """A vector in the frame whose axes are the rows of a 3x3 matrix."""
    x, y, z = (
        axes[k, 0] * vector[0] + axes[k, 1] * vector[1] + axes[k, 2] * vector[2] for k in range(3)
    )
    return x, y, z


def _solid_part(kind: Array, size: Array, x: Array, y: Array) -> Array:
    """Where a cut-out plane is not cut out, in its own coordinates, meters."""

    def none(x: Array, y: Array) -> Array:
        return jnp.ones(x.shape, bool)

    def holes(x: Array, y: Array) -> Array:
        row = jnp.floor(y / (size * 0.87))
        u = x / size + 0.5 * jnp.mod(row, 2.0)
        dx = u - jnp.floor(u) - 0.5
        dy = (y / (size * 0.87) - row - 0.5) * 0.87
        return dx * dx + dy * dy > 0.34**2

    def slats(x: Array, y: Array) -> Array:
        u = x / size
        return u - jnp.floor(u) < 0.55

    def leaves(x: Array, y: Array) -> Array:
        # A sum of waves in irrational directions: blobs and gaps without a visible period.
        u, v = x * (2 * jnp.pi / size), y * (2 * jnp.pi / size)
        waves = jnp.sin(u + 1.3 * jnp.sin(0.7 * v + 0.4)) + jnp.sin(0.83 * v - 0.51 * u + 2.0)
        waves = waves + 0.7 * jnp.sin(1.71 * u + 0.9 * v) + 0.7 * jnp.sin(1.9 * v - 1.2 * u + 1.0)
        return waves > -0.15

    return lax.switch(kind, (none, holes, slats, leaves), x, y)


def _hit_box(solids: Solids, i: Array, origin: Vector, direction: Vector) -> Array:
    """Distance to a box or plane, by its three slabs; infinite where it is missed."""
    half = solids.half[i]
    near = jnp.full_like(direction[0], -jnp.inf)
    far = jnp.full_like(direction[0], jnp.inf)
    for k in range(3):
        step = jnp.where(jnp.abs(direction[k]) < _TINY, _TINY, direction[k])
        first, second = (-half[k] - origin[k]) / step, (half[k] - origin[k]) / step
        near = jnp.maximum(near, jnp.minimum(first, second))
        far = jnp.minimum(far, jnp.maximum(first, second))
    x, y, _ = along(origin, direction, near)
    keep = _solid_part(solids.cutout[i], solids.cutout_size[i], x, y)
    return jnp.where((near <= far) & keep, near, jnp.inf)


def _hit_round(solids: Solids, i: Array, origin: Vector, direction: Vector) -> Array:
    """Distance to a sphere or a round-ended bar; infinite where it is missed."""
    radius, reach = solids.half[i, 0], solids.half[i, 2]
    # Start from the ray's point nearest to the center: float32 would lose a thin bar to
    # cancellation between squares of the distance.
    norm = dot(direction, direction)
    shift = -dot(origin, direction) / norm
    o = along(origin, direction, shift)

    def ball(offset: Array) -> Array:
        centerd = (o[0], o[1], o[2] - offset)
        middle = -dot(centerd, direction) / norm
        miss = along(centerd, direction, middle)
        square = (radius * radius - dot(miss, miss)) / norm
        return jnp.where(square >= 0, middle - jnp.sqrt(jnp.maximum(square, 0.0)), jnp.inf)

    across = direction[0] ** 2 + direction[1] ** 2
    safe = jnp.maximum(across, _TINY)
    middle = -(o[0] * direction[0] + o[1] * direction[1]) / safe
    px, py = o[0] + middle * direction[0], o[1] + middle * direction[1]
    square = (radius * radius - px * px - py * py) / safe
    body = middle - jnp.sqrt(jnp.maximum(square, 0.0))
    inside = (square >= 0) & (jnp.abs(o[2] + body * direction[2]) <= reach) & (across > _TINY)
    body = jnp.where(inside, body, jnp.inf)
    return shift + jnp.minimum(body, jnp.minimum(ball(reach), ball(-reach)))


class _Bundle(NamedTuple):
    """A body that holds all rays: `center + t heading`, of radius `width + t spread`."""

    center: Array
    width: Array
    heading: Array
    spread: Array


def _bundle(origin: Vector, direction: Vector) -> _Bundle:
    length = lax.rsqrt(dot(direction, direction))

    def ball(vector: Vector) -> tuple[Array, Array]:
        low = jnp.stack([v.min() for v in vector])
        high = jnp.stack([v.max() for v in vector])
        return 0.5 * (low + high), 0.5 * jnp.sqrt(jnp.sum((high - low) ** 2))

    x, y, z = direction
    return _Bundle(*ball(origin), *ball((x * length, y * length, z * length)))


def _may_hit(bundle: _Bundle, solids: Solids, i: Array) -> Array:
    """Whether a bundle of rays comes near enough to a solid's bounding sphere to hit it."""
    half = solids.half[i]
    radius = jnp.where(solids.round[i], half[0] + half[2], jnp.sqrt(jnp.sum(half * half)))
    reach = 1.0001 * (radius + bundle.width)
    offset = solids.center[i] - bundle.center
    # |offset - t heading| <= reach + t spread for some t >= 0, a quadratic in t.
    a = jnp.sum(bundle.heading**2) - bundle.spread**2
    b = jnp.sum(offset * bundle.heading) + reach * bundle.spread
    c = jnp.sum(offset**2) - reach**2
    return (a <= 0) | (c <= 0) | ((b > 0) & (b * b >= a * c))


def intersect(
    solids: Solids, origin: Vector, direction: Vector
) -> tuple[Float[Array, " r"], Int[Array, " r"]]:
    """The nearest solid in front of each ray: distance in units of `direction`, and index.

    Infinite and -1 where nothing is hit. Solids that the rays pass by as a whole are skipped: rays
    through a small tile of the picture are quick.
    """
    bundle = _bundle(origin, direction)

    def test(i: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
        x, y, z = (o - solids.center[i, k] for k, o in enumerate(origin))
        o, d = rotate(solids.axes[i], (x, y, z)), rotate(solids.axes[i], direction)
        distance = lax.cond(
            solids.round[i],
            lambda o, d: _hit_round(solids, i, o, d),
            lambda o, d: _hit_box(solids, i, o, d),
            o,
            d,
        )
        closer = (distance > 0) & (distance < best[0])
        return jnp.where(closer, distance, best[0]), jnp.where(closer, i, best[1])

    def step(i: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
        near = _may_hit(bundle, solids, i)
        return lax.cond(near, lambda best: test(i, best), lambda best: best, best)

    start = jnp.full_like(direction[0], jnp.inf)
    nothing = jnp.full(start.shape, -1, jnp.int32)
    return lax.fori_loop(0, solids.count, step, (start, nothing))


def intersect_and_shadow(
    solids: Solids, origin: Vector, direction: Vector, lamp: Vector, shadows: Bool[Array, ""]
) -> tuple[Float[Array, " r"], Int[Array, " r"], Bool[Array, " r"]]:
    """As `intersect`, and where something hides the lamp, whose direction is given per ray.

    Both passes go through one loop, which halves the compile time; without shadows the second does
    not run.
    """
    zero = jnp.zeros_like(direction[0])
    start = tuple(o + zero for o in origin)

    def trace(k: Array, state: tuple) -> tuple:
        (x, y, z), towards, distance, index, _ = state
        hit, which = intersect(solids, (x, y, z), towards)
        first = k == 0
        # A little towards the camera, off the surface.
        reach = jnp.where(jnp.isfinite(hit), hit * (1.0 - _LIFT), 0.0)
        return (
            along((x, y, z), towards, reach),
            lamp,
            jnp.where(first, hit, distance),
            jnp.where(first, which, index),
            jnp.isfinite(hit) & ~first,
        )

    state = (start, direction, zero, jnp.zeros(zero.shape, jnp.int32), jnp.zeros(zero.shape, bool))
    passes = jnp.where(shadows, 2, 1).astype(jnp.int32)
    _, _, distance, index, hidden = lax.fori_loop(0, passes, trace, state)
    return distance, index, hidden
