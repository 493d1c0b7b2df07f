"""Segments of the EPIs of the crosshair: what the thesis' superpixels are made of (4.2.1)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from mvedge_jax._crosshair import view_steps
from mvedge_jax.edges.thesis import LineSearch, arm_lines
from mvedge_jax.epi import EpiLines, FilterBank, epi_edge_map, prewitt_bank

from ._lfsp_painting import Ends, painted, width_of
from .epi_segments import match_segments, opening_sides

# Slopes of the filters, at most and apart, px over the height of an EPI; the authors'.
_STEEPEST, _STEP = 28, 2
# Lines of one direction that become lines of the other have no other one so near, px.
_THIN = 6.0
# Segments wider than this are split, px.
_WIDEST = 15.0
# Radius of the median of the disparities at which they are split, px.
_MEDIAN = 5
# Lines per EPI are padded to a multiple of this.
_SLOTS = 32


class Lines(NamedTuple):
    """Lines of the EPIs of one direction, on the host: `[epi, line]`, padded."""

    position: np.ndarray
    disparity: np.ndarray
    valid: np.ndarray


class Segments(NamedTuple):
    """Segments of one direction, between two lines.

    Attributes:
        epi: number of the EPI.
        left: where the left line crosses the center view, and its disparity.
        right: the same of the right line.
        views: of an EPI.
    """

    epi: np.ndarray
    left: np.ndarray
    right: np.ndarray
    views: int

    @property
    def disparity(self) -> np.ndarray:
        """Of the farther line."""
        return np.minimum(self.left[:, 1], self.right[:, 1])

    def only(self, chosen: np.ndarray) -> "Segments":
        """Some of them."""
        return Segments(self.epi[chosen], self.left[chosen], self.right[chosen], self.views)


def bank_of(views: int, dtype) -> FilterBank:
    """Filters of evenly spaced slopes for EPIs of so many views."""
    slopes = jnp.arange(-_STEEPEST, _STEEPEST + 1, _STEP, dtype=dtype) / views
    return prewitt_bank(slopes, views, _STEEPEST // 2 + 1)


@jax.jit
def _found(
    lab: Float[Array, "u e x 3"],
    smooth: Float[Array, "u e x 3"],
    params: LineSearch,
) -> tuple[EpiLines, Bool[Array, "e m"], Float[Array, "e u x"]]:
    """Lines of an arm, which of them stay, and the edge map of every EPI."""
    bank = bank_of(lab.shape[0], lab.dtype)
    found = arm_lines(lab, bank, params, key=None)

    def edges(epi: Array) -> Array:
        return epi_edge_map(epi, bank, modulate=True)[0]

    return found.lines, found.keep, lax.map(edges, jnp.moveaxis(smooth, 1, 0))


def _gathered(own: tuple, other: tuple, steps: np.ndarray) -> Lines:
    """The lines of one direction with those of the other one and of the frame."""
    (numbers, keep), (others, kept) = own, other
    count, width = len(keep), len(kept)
    # A line of the other direction is a point of the center view; so it is one of this one.
    across = np.broadcast_to(np.arange(width, dtype=numbers.dtype)[:, None], kept.shape)
    epi = np.rint(others[..., 0]).astype(int)
    inside = kept & (epi >= 0) & (epi < count)
    points = np.stack([across, others[..., 1]], axis=-1)[inside]
    epi, strength = epi[inside], others[..., 2][inside]
    order = np.argsort(-strength, kind="stable")
    epi, points = epi[order], points[order]
    rows = [_merged(numbers[k, keep[k], :2], points[epi == k], steps, width) for k in range(count)]
    most = -(-max(len(row) for row in rows) // _SLOTS) * _SLOTS
    padded = np.zeros((count, most, 2), numbers.dtype)
    valid = np.zeros((count, most), bool)
    for k, row in enumerate(rows):
        padded[k, : len(row)], valid[k, : len(row)] = row, True
    return Lines(padded[..., 0], padded[..., 1], valid)


def _merged(lines: np.ndarray, more: np.ndarray, steps: np.ndarray, width: int) -> np.ndarray:
    """Adds lines that are neither near nor across one that is there; then the frame."""
    taken = np.empty((len(lines) + len(more), 2))
    count = len(lines)
    taken[:count] = lines[:, :1] + steps[[0, -1]] * lines[:, 1:]
    kept = []
    for line in more:
        ends = line[0] + steps[[0, -1]] * line[1]
        gap = taken[:count] - ends
        crosses = gap[:, 0] * gap[:, 1] <= 0
        if np.any(crosses | (np.abs(gap).max(axis=1) < _THIN)):
            continue
        taken[count] = ends
        count += 1
        kept.append(line)
    frame = [[-0.5, 0.0], [width - 0.5, 0.0]]
    return np.concatenate([lines, np.array(kept).reshape(-1, 2), frame])


def matched(lines: Lines, edges: np.ndarray) -> Segments:
    """Segments of the EPIs of one direction.

    Args:
        lines: of its EPIs.
        edges: edge maps of its EPIs.

    Returns:
        The segments, EPI by EPI.
    """
    views = edges.shape[1]
    epis, left, right = [], [], []
    for k, (place, slope, valid) in enumerate(zip(*lines, strict=True)):
        arrays = jnp.asarray(place), jnp.asarray(slope)
        there, pair = jnp.asarray(valid), np.stack([place, slope], axis=1)
        opens = opening_sides(*arrays, jnp.asarray(edges[k]), there)
        following = np.asarray(match_segments(*arrays, opens, there, views=views).right)
        starts = np.flatnonzero(following >= 0)
        epis.append(np.full(len(starts), k))
        left.append(pair[starts])
        right.append(pair[following[starts]])
    return Segments(np.concatenate(epis), np.concatenate(left), np.concatenate(right), views)


def split(segments: Segments, disparity: np.ndarray) -> Segments:
    """Halves segments that are too wide, at the disparity of the center view there.

    Args:
        segments: of one direction.
        disparity: of the center view, `[epi, pixel]`.
    """
    epi, left, right, views = segments
    while True:
        gap, slope = right[:, 0] - left[:, 0], right[:, 1] - left[:, 1]
        wide = gap - views // 2 * np.abs(slope) > _WIDEST
        if not wide.any():
            return Segments(epi, left, right, views)
        middle = np.rint((left[wide, 0] + right[wide, 0]) / 2)
        middle = np.clip(middle, 0, disparity.shape[1] - 1)
        new = np.stack([middle, disparity[epi[wide], middle.astype(int)]], axis=1)
        old = right.copy()
        old[wide] = new
        epi = np.concatenate([epi, epi[wide]])
        left, right = np.concatenate([left, new]), np.concatenate([old, right[wide]])


def center_disparity(segments: Segments, shape: tuple[int, int]) -> np.ndarray:
    """Disparity of the center view by the segments of one direction, `[epi, pixel]`."""
    ends = Ends.of(segments.epi, segments.left, segments.right)
    disparity = jnp.asarray(segments.disparity)
    steps = jnp.zeros(2, disparity.dtype)
    index = painted(ends, disparity, steps, shape=shape, width=width_of(ends, 0))
    shown = np.asarray(jnp.where(index < 0, 0, disparity[jnp.maximum(index, 0)]))
    # Over ten neighbors along the EPI.
    windows = np.pad(shown, ((0, 0), (_MEDIAN, _MEDIAN)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(windows, 2 * _MEDIAN + 1, axis=1)
    return np.median(windows, axis=-1)


def crosshair_segments(
    arms: tuple[Float[Array, "u y x 3"], Float[Array, "v x y 3"]],
    smooth: list[Float[Array, "_ _ _ 3"]],
    params: LineSearch,
) -> tuple[Segments, Segments]:
    """Segments of the EPIs of the center row and of the center column of views.

    Args:
        arms: Lab of the row; of the column, x and y swapped.
        smooth: the same, smoothed.
        params: how lines are found.

    Returns:
        Of both directions, split. Runs on the host, as `match_segments` does.
    """
    found = []
    for arm, blurred in zip(arms, smooth, strict=True):
        kept, keep, edges = _found(arm, blurred, params)
        numbers = np.stack([np.asarray(a) for a in kept[:3]], axis=-1)
        found.append((numbers, np.asarray(keep), np.asarray(edges)))
    segments = []
    for own, other in (found, found[::-1]):
        steps = np.asarray(view_steps(own[2].shape[1], own[0].dtype))
        segments.append(matched(_gathered(own[:2], other[:2], steps), own[2]))
    shape = found[1][2].shape[0], found[1][2].shape[2]
    disparity = center_disparity(segments[1], shape)
    return split(segments[0], disparity.T), split(segments[1], disparity)
