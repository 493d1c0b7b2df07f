"""Band-limited procedural noise: gradient noise on an integer lattice, summed over octaves."""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

Vector = tuple[Array, Array, Array]

_OCTAVES = 12  # more than any picture resolves; the loop stops at the finest that it does
_LACUNARITY = 1.93  # not 2, so that the lattices of two octaves never line up
_FULL_CELL = 5.0  # an octave is at full strength while a lattice cell covers so many pixels ...
_EMPTY_CELL = 2.5  # ... and has faded away when a cell covers so few


def _mix(bits: Array) -> Array:
    """Scrambles 32-bit integers: a multiply-xorshift finaliser."""
    bits = bits ^ (bits >> 16)
    bits = bits * jnp.uint32(0x7FEB352D)
    bits = bits ^ (bits >> 15)
    bits = bits * jnp.uint32(0x846CA68B)
    return bits ^ (bits >> 16)


def hash_unit(i: Array, j: Array, seed: Array, dtype: Any) -> Array:
    """A pseudo-random number in [0, 1) for each pair of lattice indices, held as floats."""
    bits = i.astype(jnp.int32).astype(jnp.uint32) * jnp.uint32(0x9E3779B1)
    bits = bits + j.astype(jnp.int32).astype(jnp.uint32) * jnp.uint32(0x85EBCA77)
    bits = _mix(bits + (seed.astype(jnp.uint32) * jnp.uint32(0xC2B2AE3D)))
    return (bits >> 8).astype(dtype) * (1.0 / 2**24)


def gradient_noise(point: Vector, seed: Int[Array, "*s"]) -> Float[Array, "*s"]:
    """Perlin's gradient noise in three dimensions, about [-1, 1], one lattice cell per unit.

    A random gradient sits on each integer point; the value is the quintic blend of the linear
    functions of the eight corners: twice continuously differentiable, spectrum centered on one
    cycle per one to two cells. Each seed is another noise.
    """
    dtype = point[0].dtype
    cell = [jnp.floor(p) for p in point]
    offset = [p - c for p, c in zip(point, cell, strict=True)]
    blend = [t * t * t * (t * (t * 6.0 - 15.0) + 10.0) for t in offset]
    primes = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
    low = [
        c.astype(jnp.int32).astype(jnp.uint32) * jnp.uint32(prime)
        for c, prime in zip(cell, primes, strict=True)
    ]
    salt = _mix(seed.astype(jnp.uint32) + jnp.uint32(0x27D4EB2F))

    def corner(dx: int, dy: int, dz: int) -> Array:
        bits = salt
        for k, step in enumerate((dx, dy, dz)):
            # A sum: with exclusive or, opposite odd cells would have equal gradients.
            bits = bits + (low[k] + jnp.uint32(step * primes[k]))
        bits = _mix(bits)
        value = jnp.zeros_like(point[0])
        for k, step in enumerate((dx, dy, dz)):
            component = ((bits >> (10 * k)) & 1023).astype(dtype) * (2.0 / 1023.0) - 1.0
            value = value + component * (offset[k] - step)
        return value

    def lerp(a: Array, b: Array, t: Array) -> Array:
        return a + (b - a) * t

    planes = []
    for dz in (0, 1):
        lines = [lerp(corner(0, dy, dz), corner(1, dy, dz), blend[0]) for dy in (0, 1)]
        planes.append(lerp(lines[0], lines[1], blend[1]))
    return lerp(planes[0], planes[1], blend[2])


def fractal_noise(
    point: Vector,
    frequency: Float[Array, "*s"],
    gain: Float[Array, "*s"],
    footprint: Float[Array, "*s"],
    seed: Int[Array, "*s"],
) -> Float[Array, "*s"]:
    """Sums octaves of gradient noise up to what a pixel resolves, like the 1/f of natural images.

    Octave `o` has `frequency * 1.93**o` cells per unit and the amplitude `gain**o`. It fades out as
    its cells shrink from 5 to 2.5 pixels, of the width `footprint`, so the picture is band-limited
    at any resolution, and since the footprint belongs to the surface point, views of one rig agree
    on it.
    """
    finest = jnp.max(1.0 / (frequency * footprint * _EMPTY_CELL))
    count = jnp.ceil(jnp.log(jnp.maximum(finest, 1.0)) / math.log(_LACUNARITY))
    count = jnp.clip(count, 0, _OCTAVES).astype(jnp.int32)

    def octave(o: Array, total: Array) -> Array:
        power = o.astype(total.dtype)
        scale = frequency * jnp.exp(power * math.log(_LACUNARITY))
        cell = 1.0 / (scale * footprint)
        amplitude = jnp.exp(power * jnp.log(gain))
        amplitude = amplitude * jnp.clip(
            (cell - _EMPTY_CELL) / (_FULL_CELL - _EMPTY_CELL), 0.0, 1.0
        )
        x, y, z = (p * scale + (0.37 + 0.21 * k) for k, p in enumerate(point))
        return total + amplitude * gradient_noise((x, y, z), seed + o * 101)

    return lax.fori_loop(0, count, octave, jax.tree.map(jnp.zeros_like, point[0]))
