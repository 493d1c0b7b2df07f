"""Alignment of lines with the gradient of their EPI: outlier rejection and visibility."""

import math
from typing import Literal

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._crosshair import view_steps
from mvedge_jax.epi import EpiLines

Tested = Literal["all", "crossed"]
Angle = Float[Array, ""] | float
FILTER_ANGLE = math.pi / 13
VISIBLE_ANGLE = math.pi / 10


def _sobel(epi: Float[Array, "u x"]) -> tuple[Array, Array]:
    padded = jnp.pad(epi, ((1, 1), (1, 1)), mode="edge")
    down = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    along = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    return down[:, 2:] - down[:, :-2], along[2:] - along[:-2]


def alignment(epi: Float[Array, "u x"], lines: EpiLines) -> Float[Array, "m u"]:
    """Absolute cosine between a line's normal and the EPI's gradient, in every row.

    The sign of an edge is arbitrary, hence the absolute value. 0, not aligned, at flat pixels, in
    slots that are not valid and outside the image.

    Source: Thesis 4.1.5, the cosines of Eq. 4.3 and 4.4.
    """
    views, width = epi.shape
    across, down = _sobel(epi)
    rows = jnp.arange(views, dtype=jnp.int32)
    steps = view_steps(views, epi.dtype)
    x = lines.position[:, None] + steps[None] * lines.disparity[:, None]
    inside = (x >= -0.5) & (x <= width - 0.5)
    column = jnp.clip(jnp.round(x).astype(jnp.int32), 0, width - 1)
    gx, gu = across[rows[None], column], down[rows[None], column]
    # x(u) = x_c + (u_c - u) d: along the line x falls by d per row, so its normal is (1, d).
    dot = jnp.abs(gx + gu * lines.disparity[:, None])
    square = (gx * gx + gu * gu) * (1 + lines.disparity**2)[:, None]
    flat = square <= 1e-12
    cosine = dot / jnp.sqrt(jnp.where(flat, 1, square))
    return jnp.where(flat | ~inside | ~lines.valid[:, None], 0, cosine)


def _within(cosine: Float[Array, "m u"], angle: Angle) -> Bool[Array, "m u"]:
    return cosine > jnp.cos(jnp.asarray(angle, cosine.dtype))


def aligned_count(cosine: Float[Array, "m u"], *, angle: Angle = FILTER_ANGLE) -> Int[Array, " m"]:
    """Number of rows in which each line is aligned; the thesis asks for a quarter (Eq. 4.3)."""
    return _within(cosine, angle).sum(-1)


def longest_run(cosine: Float[Array, "m u"], *, angle: Angle = FILTER_ANGLE) -> Int[Array, " m"]:
    """Length of the longest run of aligned rows; the authors' program asks for 4."""
    aligned = _within(cosine, angle)

    def advance(carry: tuple[Array, Array], hit: Array) -> tuple[tuple[Array, Array], None]:
        run, best = carry
        run = jnp.where(hit, run + 1, 0)
        return (run, jnp.maximum(best, run)), None

    nothing = jnp.zeros(cosine.shape[0], jnp.int32)
    (_, best), _ = lax.scan(advance, (nothing, nothing), aligned.T)
    return best


def line_visibility(
    cosine: Float[Array, "m u"],
    lines: EpiLines,
    *,
    width: int,
    tested: Tested = "all",
    angle: Angle = VISIBLE_ANGLE,
) -> Bool[Array, "m u"]:
    """In which views of an arm each line is seen: inside the image, where it is aligned.

    With `"crossed"`, lines that no nearer line crosses are seen in all views inside the image, and
    what the test says of the others is cleaned by a median of three along the views.

    Source: Thesis 4.1.5, Eq. 4.4, which is about the center view; `"crossed"` is the authors'.
    """
    views = cosine.shape[1]
    steps = view_steps(views, cosine.dtype)
    x = lines.position[:, None] + steps[None] * lines.disparity[:, None]
    inside = (x >= -0.5) & (x <= width - 0.5) & lines.valid[:, None]
    seen = _within(cosine, angle)
    if tested == "all":
        return seen & inside
    top = x[:, None, 0] - x[None, :, 0]
    bottom = x[:, None, -1] - x[None, :, -1]
    nearer = lines.disparity[None, :] > lines.disparity[:, None]
    crossed = ((top * bottom <= 0) & nearer & lines.valid[None]).any(1)
    before = jnp.pad(seen[:, :-1], ((0, 0), (1, 0)))
    after = jnp.pad(seen[:, 1:], ((0, 0), (0, 1)))
    median = (before & seen) | (seen & after) | (before & after)
    return jnp.where(crossed[:, None], median, True) & inside
