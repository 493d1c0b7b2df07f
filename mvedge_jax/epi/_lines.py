"""Lines in epipolar-plane images: the edge map of Alg. 1, greedy fitting, merging of scales."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._crosshair import view_steps
from mvedge_jax._params import accepts_numpy
from mvedge_jax._root import safe_sqrt
from mvedge_jax.interpolation import vertex

from ._bank import FilterBank
from ._response import bank_response


class EpiLines(NamedTuple):
    """Padded lines of one EPI; `vmap` over EPIs. Slots that are not `valid` hold zeros.

    Attributes:
        position: where the line crosses the center view, px.
        disparity: px per view step.
        confidence: filter response.
        valid: which slots hold a line.
    """

    position: Float[Array, "*e m"]
    disparity: Float[Array, "*e m"]
    confidence: Float[Array, "*e m"]
    valid: Bool[Array, "*e m"]


def _local_deviation(epi: Float[Array, "u x c"]) -> Float[Array, "u x c"]:
    """Standard deviation over 3x3 pixels, border values repeated."""
    padded = jnp.pad(epi, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows, columns = epi.shape[:2]
    parts = [padded[j : j + rows, i : i + columns] for j in range(3) for i in range(3)]
    stack = jnp.stack(parts)
    return safe_sqrt(((stack - stack.mean(0)[None]) ** 2).mean(0))


@accepts_numpy
def epi_edge_map(
    epi: Float[Array, "u x c"],
    bank: FilterBank,
    *,
    modulate: bool = False,
    interpolate: bool = False,
) -> tuple[Float[Array, "u x"], Float[Array, "u x"]]:
    """Edge confidence and slope at every pixel of an EPI, all rows.

    All rows of a line see the same filter sum, so the response of row `u` at `x` to disparity `d`
    is that of the center row at `x - (u_c - u) d`. Where lines cross, each wins on the rows where
    it is apart from the other: both survive.

    Args:
        epi: Lab values of one EPI, views by pixels.
        bank: the filters.
        modulate: multiply by the standard deviation of 3x3 pixels of the EPI (Alg. 1).
        interpolate: the disparity is that of the vertex of the parabola through the responses of
            the winning filter and of the two beside it, not that of the filter.

    Returns:
        Confidence after non-maximum suppression across the line (0 elsewhere), and the disparity of
        the winning filter, both of the channel with the largest confidence. The confidence is
        differentiable in the EPI and the taps, and so is an interpolated disparity.

    Source: Thesis 4.1.1, Alg. 1; absolute response, suppressed per channel.
    """
    views, width, _ = epi.shape
    response = jnp.abs(bank_response(epi[:, None], bank)[0])
    steps = view_steps(views, epi.dtype)

    def row(step: Array) -> tuple[Array, Array]:
        source = jnp.arange(width, dtype=epi.dtype)[:, None] - step * bank.disparity[None]
        whole = jnp.floor(source)
        part = source - whole
        index = whole.astype(jnp.int32)[:, None]

        def at(offset: int) -> Array:
            clipped = jnp.clip(index + offset, 0, width - 1)
            return jnp.take_along_axis(response, clipped, 0)

        shifted = (1 - part)[:, None] * at(0) + part[:, None] * at(1)
        best = jnp.argmax(shifted, -1)
        value = jnp.take_along_axis(shifted, best[..., None], -1)[..., 0]
        if interpolate:
            return value, _vertex(shifted, best, bank.disparity)
        return value, bank.disparity[best]

    value, disparity = jax.vmap(row)(steps)
    confidence = _suppressed(value, disparity)
    if modulate:
        confidence = confidence * _local_deviation(epi)
    strongest = jnp.argmax(confidence, -1)[..., None]
    confidence, disparity = (
        jnp.take_along_axis(of, strongest, -1)[..., 0] for of in (confidence, disparity)
    )
    return confidence, disparity


def _suppressed(value: Float[Array, "u x c"], slope: Float[Array, "u x c"]) -> Array:
    """Values that exceed those on both sides of their line; 0 elsewhere.

    The line through a pixel moves by -slope per row, so its normal is (1, slope). Beside it stands
    a mean of the diagonal neighbor and of the one along the normal's longer axis, whose weights are
    linear in the normal's angle, as in the authors' program.
    """
    views, width, _ = value.shape
    padded = jnp.pad(value, ((1, 1), (1, 1), (0, 0)), mode="edge")

    def neighbor(rows: int, columns: int) -> Array:
        return padded[1 + rows : 1 + rows + views, 1 + columns : 1 + columns + width]

    steep, share = jnp.abs(slope) > 1, 2 / jnp.pi * jnp.arctan(jnp.abs(slope))

    def beside(side: int) -> Array:
        up, down = neighbor(-side, side), neighbor(side, side)
        vertical = jnp.where(slope > 0, neighbor(side, 0), neighbor(-side, 0))
        straight = jnp.where(steep, vertical, neighbor(0, side))
        return (1 - share) * straight + share * jnp.where(slope > 0, down, up)

    return jnp.where((value > beside(1)) & (value > beside(-1)), value, 0)


def _vertex(
    response: Float[Array, "x c k"], best: Int[Array, "x c"], disparity: Float[Array, " k"]
) -> Float[Array, "x c"]:
    """Disparity at the vertex of the parabola through the best response and those beside it.

    In the numbers of the filters, between whose disparities it is linear; at the ends of the bank,
    that of the filter.
    """
    last = disparity.shape[0] - 1
    inside = (best > 0) & (best < last)
    middle = jnp.clip(best, 1, last - 1)
    before, at, after = (
        jnp.take_along_axis(response, (middle + k)[..., None], -1)[..., 0] for k in (-1, 0, 1)
    )
    # Half a filter at most: rounding may have it more where the best has an equal beside it.
    offset = jnp.where(inside, jnp.clip(vertex(before, at, after), -0.5, 0.5), 0)
    beside = jnp.clip(jnp.where(offset < 0, best - 1, best + 1), 0, last)
    return disparity[best] + jnp.abs(offset) * (disparity[beside] - disparity[best])


@accepts_numpy
def fit_lines(
    confidence: Float[Array, "u x"],
    disparity: Float[Array, "u x"],
    radius: Float[Array, ""],
    *,
    capacity: int,
) -> tuple[EpiLines, Int[Array, ""]]:
    """Forms lines from the pixels of an edge map, strongest first.

    Each line removes the pixels within a perpendicular distance of itself, until none is left or
    the slots are full.

    Args:
        confidence: edge confidence, 0 where there is no edge.
        disparity: slope at each pixel.
        radius: suppression radius, px; the thesis has 0.2 times the height of the EPI.
        capacity: slots.

    Returns:
        The lines, and the number of pixels left over when the slots were full.

    Source: Thesis 4.1.2.
    """
    views, width = confidence.shape
    steps = view_steps(views, confidence.dtype)[:, None]
    columns = jnp.arange(width, dtype=confidence.dtype)[None]

    def take(left: Array, _: None) -> tuple[Array, tuple[Array, ...]]:
        best = jnp.argmax(left)
        u, x = best // width, best % width
        strength, slope = left[u, x], disparity[u, x]
        position = x.astype(slope.dtype) - steps[u, 0] * slope
        distance = jnp.abs(columns - position - steps * slope) / jnp.sqrt(1 + slope * slope)
        there = strength > 0
        rest = jnp.where(there & (distance < radius), 0, left)
        return rest, (position, slope, strength, there)

    rest, (position, slope, strength, there) = lax.scan(take, confidence, None, length=capacity)
    return _masked(position, slope, strength, there), (rest > 0).sum()


def _masked(position: Array, disparity: Array, confidence: Array, valid: Array) -> EpiLines:
    """Lines with zeros in slots that are not valid."""
    position, disparity, confidence = (
        jnp.where(valid, of, 0) for of in (position, disparity, confidence)
    )
    return EpiLines(position, disparity, confidence, valid)


def _ends(lines: EpiLines, views: int) -> tuple[Array, Array]:
    first, last = views // 2, views // 2 - (views - 1)
    return lines.position + first * lines.disparity, lines.position + last * lines.disparity


@accepts_numpy
def merge_scales(
    fine: EpiLines, coarse: EpiLines, radius: Float[Array, ""], *, views: int
) -> EpiLines:
    """Adds the lines of a coarser scale that a finer one has not found.

    A coarse line is dropped if both of its ends are within `radius` of those of a fine line, or if
    it crosses a fine line: then it is a blurred version of what is there.

    Args:
        fine: lines of an EPI at this scale.
        coarse: lines of the same EPI found on views of half the size, in the pixels of those.
        radius: px of the fine scale.
        views: height of the EPI.

    Returns:
        Fine lines followed by the coarse ones that were kept, at the fine scale. A coarse pixel's
        center lies half a fine pixel off: `x_fine = 2 x + 0.5`.

    Source: Thesis 4.1.4; the crossing test is the authors'.
    """
    grown = EpiLines(
        jnp.where(coarse.valid, 2 * coarse.position + 0.5, 0),
        2 * coarse.disparity,
        coarse.confidence,
        coarse.valid,
    )
    fine_top, fine_bottom = _ends(fine, views)
    top, bottom = _ends(grown, views)
    at_top = top[:, None] - fine_top[None]
    at_bottom = bottom[:, None] - fine_bottom[None]
    near = (jnp.abs(at_top) <= radius) & (jnp.abs(at_bottom) <= radius)
    crossing = at_top * at_bottom < 0
    known = ((near | crossing) & fine.valid[None]).any(1)
    keep = grown.valid & ~known
    added = _masked(grown.position, grown.disparity, grown.confidence, keep)
    return EpiLines(*(jnp.concatenate([a, b]) for a, b in zip(fine, added, strict=True)))
