"""Checks the order of the views: near surfaces must cover far ones."""

import dataclasses
import math

import cv2
import numpy as np

from mvedge_jax.lightfield import LightField

from ._matches import BEHIND, HEIGHT, WINDOW, Matches, Strips, Views, match

# Sizes in pixels, contrasts in sRGB units; measured on the benchmark's scenes and a Lytro's.
_VIEWS = 9  # central views of an arm that are looked at
_REACH = 8.0  # px per view step that are searched if no range is known
_EDGE = 0.02  # smallest gradient per pixel of an edge
_SIDE = (4, 10)  # px beside an edge at which its sides are measured
_LEVEL = 0.15  # largest difference of an edge from the surface that owns it
_SHARED = 2.0  # votes that are in truth one, as neighboring strips see the same edge
_DECISIVE = 6.0  # difference of two hypotheses, in standard deviations of their votes
_FEW = 20  # matches in a few strips, below which nothing is known
_MATCHED = 40  # matches of what moves across the axes, from which on the grid may be exchanged
_EXCHANGED = 4  # multiples of the matches along the axes that it takes


@dataclasses.dataclass(frozen=True)
class ConventionCheck:
    """The order of a light field's views, by its occlusions.

    Two kinds of votes test whether the surface in front has the larger disparity. An occlusion's
    contour belongs to the nearer surface and moves with it: an edge of the image that moves like
    the surface on one side and unlike the one on the other votes for its owner. A spot that is
    hidden in the views to one side votes for the surface that moves over it there. A reversed view
    axis negates all disparities along it, and so all its votes. Both axes must also have the same
    disparity. If that does not decide, votes at half the size are added. If hardly anything can be
    matched along the axes, but much across them, rows and columns of the grid are exchanged.

    Attributes:
        columns: votes along `u`, (for the convention, against it).
        rows: votes along `v`, (for the convention, against it).
        agreement: windows at which both axes have (the same, the opposite) disparity.
        flip_u: whether the view columns are reversed; None if undecided.
        flip_v: whether the view rows are reversed; None if undecided.
        disparity_range: (low, high) of the matches, px per view step; None without matches.
        swap_axes: whether rows and columns of the grid are exchanged; all other fields then
            describe the grid with exchanged axes.
    """

    columns: tuple[int, int]
    rows: tuple[int, int]
    agreement: tuple[int, int]
    flip_u: bool | None
    flip_v: bool | None
    disparity_range: tuple[float, float] | None
    swap_axes: bool = False

    @property
    def holds(self) -> bool | None:
        """Whether the convention holds; None if an axis is undecided."""
        if self.flip_u or self.flip_v or self.swap_axes:
            return False
        return None if self.flip_u is None or self.flip_v is None else True

    @property
    def votes(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        """`columns`, `rows` and `agreement`."""
        return self.columns, self.rows, self.agreement


def check_convention(
    light_field: LightField, *, disparity_range: tuple[float, float] | None = None
) -> ConventionCheck:
    """Checks from the EPIs whether the view axes follow the convention.

    Photo-consistency does not detect a reversed axis, which only negates its disparities;
    occlusions do. Ground truth is not read. NumPy on the host, seconds for 9x9 views of 512x512.

    Args:
        light_field: at least 3x3 views; the crosshair is enough.
        disparity_range: where to search, and of the other sign, (low, high) in px per view step;
            by default the light field's own range, widened, or the result of a coarse search.

    Returns:
        The votes, and the required changes.

    Raises:
        ValueError: if there are fewer than three views on an arm, or the views are too small.

    Example:
        >>> import jax.numpy as jnp
        >>> check = check_convention(LightField(jnp.zeros((3, 3, 32, 32, 3))))
        >>> check.holds is None
        True
    """
    height, width = light_field.views.shape[2:4]
    if min(light_field.views.shape[:2]) < 3 or min(height, width) < 4 * HEIGHT:
        raise ValueError(
            "the convention can be checked on 3x3 views or more of at least "
            f"{4 * HEIGHT}x{4 * HEIGHT} px, got {light_field.views.shape[:4]}."
        )
    (vc, uc), there = light_field.center, np.asarray(light_field.available)
    steps = np.asarray(light_field.steps, np.float32)
    horizontal, vertical = (
        np.asarray(arm, np.float32)
        for arm in (light_field.horizontal_arm, light_field.vertical_arm)
    )
    across = _central(horizontal, there[vc], steps[vc, :, 0])
    down = _central(vertical, there[:, uc], steps[:, uc, 1])
    if disparity_range is None and light_field.disparity_range is not None:
        low, high = (float(limit) for limit in light_field.disparity_range)
        disparity_range = low - 0.2, high + 0.2
    reach = None if disparity_range is None else max(abs(limit) for limit in disparity_range)
    arms, exchanged = [across, down.turned()], [down, across.turned()]
    found, other = _search(arms, reach), _search(exchanged, reach)
    # Static points match either way, unless they have detail across the axis.
    along, turned = ((matches > 2 * _LEVEL).sum() for matches in (found, other))
    swap_axes = bool(turned >= _MATCHED and turned > _EXCHANGED * along)
    if swap_axes:
        arms, found = exchanged, other
    if reach is None:
        if found.size < _FEW:
            return ConventionCheck((0, 0), (0, 0), (0, 0), None, None, None)
        reach = float(np.percentile(found, 99)) + 0.3
    full = _check(arms, reach)
    if None not in (full.flip_u, full.flip_v) or min(height, width) < 8 * HEIGHT:
        return dataclasses.replace(full, swap_axes=swap_axes)
    # At half the size noise is averaged and surfaces meet within fewer pixels.
    half = _check([arm.halved() for arm in arms], reach / 2)
    columns, rows, agreement = (
        (one[0] + other[0], one[1] + other[1])
        for one, other in zip(full.votes, half.votes, strict=True)
    )
    flips = _decide(columns, rows, agreement)
    return ConventionCheck(columns, rows, agreement, *flips, full.disparity_range, swap_axes)


def _check(arms: list[Views], reach: float) -> ConventionCheck:
    (columns, across), (rows, along) = [_arm(arm, reach) for arm in arms]
    agreement = _agreement(across, along)
    found = np.concatenate([s.disparity[s.valid] for s in (across, along)])
    limits = None
    if found.size:
        limits = float(np.percentile(found, 0.5)), float(np.percentile(found, 99.5))
    return ConventionCheck(columns, rows, agreement, *_decide(columns, rows, agreement), limits)


def _central(images: np.ndarray, there: np.ndarray, steps: np.ndarray) -> Views:
    middle, half = len(there) // 2, min(_VIEWS, len(there)) // 2
    kept = slice(middle - half, middle + half + 1)
    return Views(images[kept], there[kept], steps[kept])


def _search(arms: list[Views], reach: float | None) -> np.ndarray:
    """Disparities, without their signs, that a few strips of either arm can be matched at."""
    found = []
    for arm in arms:
        far = arm.images.shape[2] / (4 * arm.farthest)
        strips = match(arm, min(_REACH, far) if reach is None else reach, 12).through
        found.append(np.abs(strips.disparity[strips.valid]))
    return np.concatenate(found)


def _arm(arm: Views, reach: float) -> tuple[tuple[int, int], Strips]:
    """Votes along one arm, and its matches."""
    matches = match(arm, reach, arm.images.shape[1])
    votes = np.concatenate([_contours(matches), _hidden(matches, arm.farthest, reach)])
    return (int((votes > 0).sum()), int((votes < 0).sum())), matches.through


def _contours(matches: Matches) -> np.ndarray:
    """A vote per edge that moves with the surface on one side only: +1, -1 or 0."""
    through, gradient = matches.through, matches.gradient
    # An edge: a peak of the gradient that is seen in every view, away from the border.
    peak = gradient >= cv2.dilate(gradient, np.ones((1, WINDOW), np.uint8))
    peak &= (gradient > _EDGE) & through.valid & matches.everywhere
    margin = 2 * _SIDE[1]
    peak[:, :margin] = peak[:, -margin:] = False
    e, x = np.nonzero(peak)
    edge = through.disparity[peak]
    sides = [_beside(matches.half, gradient, e, x, direction) for direction in (-1, 1)]
    owned = [np.isnan(side) | (np.abs(side - edge) < _LEVEL) for side in sides]
    behind = [np.abs(side - edge) > BEHIND for side in sides]  # False where NaN
    votes = np.zeros(len(e))
    for side, other in ((0, 1), (1, 0)):
        clear = behind[side] & owned[other]
        votes[clear] = np.sign(edge - sides[side])[clear]
    return votes


def _hidden(matches: Matches, farthest: float, reach: float) -> np.ndarray:
    """A vote per spot that one surface alone can hide, in the half of the views that miss it."""
    through, half = matches.through, matches.half
    e, x = np.nonzero(half.valid & (matches.missing != 0))
    spot, missing = half.disparity[e, x], matches.missing[e, x]
    votes = np.zeros((2, len(e)))
    width = half.disparity.shape[1]
    for row, direction in enumerate((-1, 1)):
        searching = np.ones(len(e), bool)
        for offset in range(1, math.ceil(2 * reach * farthest) + WINDOW):
            place = x + direction * offset
            inside = (place >= 0) & (place < width)
            place = place.clip(0, width - 1)
            step = through.disparity[e, place] - spot
            found = searching & inside & through.valid[e, place] & (np.abs(step) > BEHIND)
            # In the views that miss the spot, does it move over it, and far enough?
            covers = found & (missing * step * direction < 0)
            covers &= offset <= farthest * np.abs(step) + WINDOW // 2
            votes[row, covers] = np.sign(step)[covers]
            searching &= ~found
    return np.where((votes != 0).sum(0) == 1, votes.sum(0), 0)


def _beside(
    strips: Strips, gradient: np.ndarray, e: np.ndarray, x: np.ndarray, direction: int
) -> np.ndarray:
    """The disparity of the surface beside an edge; NaN if unknown or behind another edge."""
    found = np.full(len(e), np.nan)
    blocked = np.zeros(len(e), bool)
    last = gradient.shape[1] - 1
    for offset in range(_SIDE[0], _SIDE[1] + 1):
        place = x + direction * offset
        ahead = (place + direction * (WINDOW // 2)).clip(0, last)
        blocked |= gradient[e, ahead] > 0.5 * gradient[e, x]
        take = np.isnan(found) & ~blocked & strips.valid[e, place]
        found[take] = strips.disparity[e, place][take]
    return found


def _agreement(across: Strips, along: Strips) -> tuple[int, int]:
    """Windows at which the arms see the same, and the opposite, disparity."""
    # Strips of the vertical arm are columns: bring both to [row strips, column strips].
    one, other = across.disparity[:, along.y], along.disparity[:, across.y].T
    valid = across.valid[:, along.y] & along.valid[:, across.y].T
    valid &= np.maximum(np.abs(one), np.abs(other)) > 2 * _LEVEL
    same = valid & (np.abs(one - other) < _LEVEL)
    opposite = valid & (np.abs(one + other) < _LEVEL)
    return int(same.sum()), int(opposite.sum())


def _decide(
    columns: tuple[int, int], rows: tuple[int, int], agreement: tuple[int, int]
) -> tuple[bool | None, bool | None]:
    """The flips that explain the votes best, each None unless it does so decisively."""
    scores = [
        (votes[0] - votes[1]) / math.sqrt(_SHARED * (votes[0] + votes[1] + 1))
        for votes in (columns, rows, agreement)
    ]
    total = {
        (u, v): u * scores[0] + v * scores[1] + u * v * scores[2] for u in (1, -1) for v in (1, -1)
    }
    flips: list[bool | None] = []
    for axis in (0, 1):
        kept, flipped = (max(t for s, t in total.items() if s[axis] == way) for way in (1, -1))
        flips.append(flipped > kept if abs(kept - flipped) >= _DECISIVE else None)
    return flips[0], flips[1]
