"""Which way round the views are: near things must cover far ones, not the other way about."""

import dataclasses
import math

import cv2
import numpy as np
from jaxtyping import Bool, Float

from mvedge_jax.lightfield import LightField

# Sizes in pixels, contrasts in sRGB units; measured on the benchmark's scenes and a Lytro's.
_VIEWS = 9  # central views of an arm that are looked at
_MEMORY = 3e7  # matches of strips, columns and disparities that are held at a time
_HEIGHT = 5  # rows that share one disparity, to tell textures apart
_WINDOW = 5  # width of a matching window
_SIGMA = 0.7  # of the blur against aliasing
_STEP = 0.3  # px at the outermost view between two disparities that are tried
_REACH = 8.0  # px per view step that are searched if no range is known
_TEXTURE = 0.003  # smallest mean absolute deviation in a window that can be matched
_DISTINCT = 0.3  # by how much, in deviations, the next disparity must be worse
_MATCH = 0.5  # how well, in deviations, a window must match
_EDGE = 0.02  # smallest gradient per pixel of an edge
_SIDE = (4, 10)  # px beside an edge at which its sides are measured
_BEHIND = 0.3  # smallest difference in disparity of a depth edge
_LEVEL = 0.15  # largest difference of an edge from the surface that owns it
_SHARED = 2.0  # votes that are in truth one, as neighbouring strips see the same edge
_DECISIVE = 6.0  # difference of two hypotheses, in standard deviations of their votes


@dataclasses.dataclass(frozen=True)
class ConventionCheck:
    """What a light field's occlusions say about the order of its views.

    There are two kinds of votes, and both ask: does what is in front have the larger disparity?
    An occlusion's contour belongs to the nearer surface and moves with it: an edge of the image
    that moves like the surface on one side and unlike the one on the other votes for its owner. And
    a spot that is hidden in the views to one side votes for the one surface that moves over it
    there. A reversed view axis negates all disparities along it, and all its votes. The two axes
    are also held against each other: both must see the same disparity. Where that does not decide,
    votes at half the size are added.

    Attributes:
        columns: votes along `u`, (for the convention, against it).
        rows: votes along `v`, likewise.
        agreement: windows at which both axes see (the same, the opposite) disparity.
        flip_u: whether the view columns are reversed; None if the image does not tell.
        flip_v: whether the view rows are reversed; None if the image does not tell.
        disparity_range: (low, high) of what could be matched, px per view step; None if nothing.
    """

    columns: tuple[int, int]
    rows: tuple[int, int]
    agreement: tuple[int, int]
    flip_u: bool | None
    flip_v: bool | None
    disparity_range: tuple[float, float] | None

    @property
    def holds(self) -> bool | None:
        """Whether the convention holds; None if that cannot be told of one of the axes."""
        if self.flip_u or self.flip_v:
            return False
        return None if self.flip_u is None or self.flip_v is None else True

    @property
    def votes(self) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        """`columns`, `rows` and `agreement`."""
        return self.columns, self.rows, self.agreement


@dataclasses.dataclass(frozen=True)
class _Strips:
    """Matches along one arm at strips of rows: `y` centre rows, all columns."""

    y: np.ndarray
    disparity: Float[np.ndarray, "e x"]
    valid: Bool[np.ndarray, "e x"]


@dataclasses.dataclass(frozen=True)
class _Matches:
    """What one arm shows: matches `through` all views and through the better `half` of them.

    A surface beside an occluder is hidden in the views of one half, but not of the other.
    `missing` is +1 where the views before the centre lack the match of `half`, -1 where those
    after it do, 0 where neither; `gradient` is that along x; `everywhere` is where `through` holds
    in every single view.
    """

    through: _Strips
    half: _Strips
    missing: np.ndarray
    gradient: np.ndarray
    everywhere: np.ndarray


def check_convention(
    light_field: LightField, *, disparity_range: tuple[float, float] | None = None
) -> ConventionCheck:
    """Tells from the EPIs whether the view axes run as the convention wants.

    Photo-consistency cannot tell: a reversed axis only negates its disparities. Occlusions can.
    Ground truth is not looked at. NumPy on the host, a few seconds for 9x9 views of 512x512.

    Args:
        light_field: at least 3x3 views; the crosshair is enough.
        disparity_range: where to search, (low, high) in px per view step; by default the light
            field's own range, widened, or else what a coarse search finds. As an axis may be
            reversed, the negated range is searched too.

    Returns:
        The votes, and which flips they call for.

    Raises:
        ValueError: if there are fewer than three views on an arm, or the views are too small to
            hold a matching window.

    Example:
        >>> import jax.numpy as jnp
        >>> check = check_convention(LightField(jnp.zeros((3, 3, 32, 32, 3))))
        >>> check.holds is None
        True
    """
    height, width = light_field.views.shape[2:4]
    if min(light_field.views.shape[:2]) < 3 or min(height, width) < 4 * _HEIGHT:
        raise ValueError(
            "the convention can be checked on 3x3 views or more of at least "
            f"{4 * _HEIGHT}x{4 * _HEIGHT} px, got {light_field.views.shape[:4]}."
        )
    arms = [
        _central(np.asarray(light_field.horizontal_arm, np.float32)),
        _central(np.asarray(light_field.vertical_arm, np.float32)).transpose(0, 2, 1, 3),
    ]
    if disparity_range is None and light_field.disparity_range is not None:
        low, high = (float(limit) for limit in light_field.disparity_range)
        disparity_range = low - 0.2, high + 0.2
    if disparity_range is not None:
        reach = max(abs(limit) for limit in disparity_range)
    else:
        reach = _search(arms)
    if reach is None:
        return ConventionCheck((0, 0), (0, 0), (0, 0), None, None, None)
    full = _check(arms, reach)
    if None not in (full.flip_u, full.flip_v) or min(height, width) < 8 * _HEIGHT:
        return full
    # At half the size noise is averaged and surfaces meet within fewer pixels.
    half = _check([np.stack([_halved(view) for view in arm]) for arm in arms], reach / 2)
    columns, rows, agreement = (
        (one[0] + other[0], one[1] + other[1])
        for one, other in zip(full.votes, half.votes, strict=True)
    )
    flips = _decide(columns, rows, agreement)
    return ConventionCheck(columns, rows, agreement, *flips, full.disparity_range)


def _check(arms: list[np.ndarray], reach: float) -> ConventionCheck:
    (columns, across), (rows, along) = [_arm(arm, reach) for arm in arms]
    agreement = _agreement(across, along)
    found = np.concatenate([s.disparity[s.valid] for s in (across, along)])
    limits = None
    if found.size:
        limits = float(np.percentile(found, 0.5)), float(np.percentile(found, 99.5))
    return ConventionCheck(columns, rows, agreement, *_decide(columns, rows, agreement), limits)


def _halved(view: np.ndarray) -> np.ndarray:
    height, width = (side // 2 for side in view.shape[:2])
    return cv2.resize(
        view[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA
    )


def _central(arm: np.ndarray) -> np.ndarray:
    middle, half = arm.shape[0] // 2, min(_VIEWS, arm.shape[0]) // 2
    return arm[middle - half : middle + half + 1]


def _search(arms: list[np.ndarray]) -> float | None:
    """The largest disparity, either sign, that a few strips of either arm can be matched at."""
    found = []
    for arm in arms:
        reach = min(_REACH, arm.shape[2] / (4 * (arm.shape[0] // 2)))
        strips = _match(arm, reach, 12).through
        found.append(np.abs(strips.disparity[strips.valid]))
    found = np.concatenate(found)
    return None if found.size < 20 else float(np.percentile(found, 99)) + 0.3


def _arm(arm: Float[np.ndarray, "u y x c"], reach: float) -> tuple[tuple[int, int], _Strips]:
    """Votes along one arm and what was matched on it."""
    matches = _match(arm, reach, arm.shape[1])
    votes = np.concatenate([_contours(matches), _hidden(matches, arm.shape[0] // 2, reach)])
    return (int((votes > 0).sum()), int((votes < 0).sum())), matches.through


def _contours(matches: "_Matches") -> np.ndarray:
    """A vote per edge that moves with the surface on one side only: +1, -1 or 0."""
    through, gradient = matches.through, matches.gradient
    # An edge: a peak of the gradient that is seen in every view, away from the border.
    peak = gradient >= cv2.dilate(gradient, np.ones((1, _WINDOW), np.uint8))
    peak &= (gradient > _EDGE) & through.valid & matches.everywhere
    margin = 2 * _SIDE[1]
    peak[:, :margin] = peak[:, -margin:] = False
    e, x = np.nonzero(peak)
    edge = through.disparity[peak]
    sides = [_beside(matches.half, gradient, e, x, direction) for direction in (-1, 1)]
    owned = [np.isnan(side) | (np.abs(side - edge) < _LEVEL) for side in sides]
    behind = [np.abs(side - edge) > _BEHIND for side in sides]  # False where NaN
    votes = np.zeros(len(e))
    for side, other in ((0, 1), (1, 0)):
        clear = behind[side] & owned[other]
        votes[clear] = np.sign(edge - sides[side])[clear]
    return votes


def _hidden(matches: "_Matches", middle: int, reach: float) -> np.ndarray:
    """A vote per spot that one surface alone can hide, in the half of the views that miss it."""
    through, half = matches.through, matches.half
    e, x = np.nonzero(half.valid & (matches.missing != 0))
    spot, missing = half.disparity[e, x], matches.missing[e, x]
    votes = np.zeros((2, len(e)))
    width = half.disparity.shape[1]
    for row, direction in enumerate((-1, 1)):
        searching = np.ones(len(e), bool)
        for offset in range(1, math.ceil(2 * reach * middle) + _WINDOW):
            place = x + direction * offset
            inside = (place >= 0) & (place < width)
            place = place.clip(0, width - 1)
            step = through.disparity[e, place] - spot
            found = searching & inside & through.valid[e, place] & (np.abs(step) > _BEHIND)
            # In the views that miss the spot, does it move over it, and far enough?
            covers = found & (missing * step * direction < 0)
            covers &= offset <= middle * np.abs(step) + _WINDOW // 2
            votes[row, covers] = np.sign(step)[covers]
            searching &= ~found
    return np.where((votes != 0).sum(0) == 1, votes.sum(0), 0)


def _match(arm: Float[np.ndarray, "u y x c"], reach: float, count: int) -> _Matches:
    """Matches windows of at most `count` strips of rows at disparities up to `reach`."""
    views, height, width, _ = arm.shape
    middle = views // 2
    number = 2 * math.ceil(reach * middle / _STEP) + 1
    count = min(count, height // _HEIGHT, max(12, int(_MEMORY / (number * width))))
    y = np.linspace(_HEIGHT, height - 1 - _HEIGHT, count).astype(int)
    rows = (y[:, None] + np.arange(-(_HEIGHT // 2), _HEIGHT // 2 + 1)).ravel()
    arm = np.stack([cv2.GaussianBlur(view, (0, 0), _SIGMA)[rows] for view in arm])
    disparities = np.linspace(-reach, reach, number).astype(np.float32)

    def strips(image: np.ndarray) -> np.ndarray:
        grey = cv2.transform(image, np.full((1, image.shape[2]), 1 / image.shape[2], np.float32))
        return grey.reshape(len(y), _HEIGHT, width).mean(1)

    pad = math.ceil(reach * middle) + 1
    padded = [cv2.copyMakeBorder(v, 0, 0, pad, pad, cv2.BORDER_REPLICATE) for v in arm]
    halves = np.zeros((2, number, len(y), width), np.float32)
    worst = np.zeros((number, len(y), width), np.float32)
    for view in range(views):
        if view == middle:
            continue
        for k, disparity in enumerate(disparities):
            shift = float((middle - view) * disparity)
            whole = math.floor(shift)
            part, start = shift - whole, pad + whole
            seen = cv2.addWeighted(
                padded[view][:, start : start + width],
                1 - part,
                padded[view][:, start + 1 : start + 1 + width],
                part,
                0,
            )
            error = cv2.blur(strips(cv2.absdiff(seen, arm[middle])), (_WINDOW, 1))
            outside = slice(max(0, width - math.ceil(shift)), None)
            error[:, outside if shift > 0 else slice(0, math.ceil(-shift))] = 0.5
            halves[int(view > middle), k] += error / middle
            np.maximum(worst[k], error, out=worst[k])
    centre = arm[middle]
    mean = cv2.blur(centre.reshape(len(y), _HEIGHT, width, -1).mean(1), (_WINDOW, 1))
    deviation = cv2.blur(strips(np.abs(centre - np.repeat(mean, _HEIGHT, axis=0))), (_WINDOW, 1))
    through, best = _best(halves.mean(0), disparities, deviation, y)
    everywhere = np.take_along_axis(worst, best[None], 0)[0] < deviation
    half, best = _best(halves.min(0), disparities, deviation, y)
    before, after = np.take_along_axis(halves, best[None, None], 1)[:, 0] > deviation
    line = centre.reshape(len(y), _HEIGHT, width, -1).mean(1)
    slope = np.zeros((len(y), width), np.float32)
    slope[:, 1:-1] = np.abs(line[:, 2:] - line[:, :-2]).mean(-1) / 2
    return _Matches(through, half, before.astype(int) - after, slope, everywhere)


def _best(
    cost: Float[np.ndarray, "k e x"], disparities: np.ndarray, deviation: np.ndarray, y: np.ndarray
) -> tuple[_Strips, np.ndarray]:
    """The disparity of least cost, where it is good and no other is nearly as good."""
    best = cost.argmin(0)
    least = cost.min(0)
    far = np.abs(disparities[:, None, None] - disparities[best]) > _BEHIND
    next_best = np.where(far, cost, np.inf).min(0)
    valid = (deviation > _TEXTURE) & (next_best - least > _DISTINCT * deviation)
    valid &= (least < _MATCH * deviation) & (best > 0) & (best < len(disparities) - 1)
    return _Strips(y, disparities[best], valid), best


def _beside(
    strips: _Strips, gradient: np.ndarray, e: np.ndarray, x: np.ndarray, direction: int
) -> np.ndarray:
    """The disparity of the surface beside an edge; NaN if unknown or behind another edge."""
    found = np.full(len(e), np.nan)
    blocked = np.zeros(len(e), bool)
    last = gradient.shape[1] - 1
    for offset in range(_SIDE[0], _SIDE[1] + 1):
        place = x + direction * offset
        ahead = (place + direction * (_WINDOW // 2)).clip(0, last)
        blocked |= gradient[e, ahead] > 0.5 * gradient[e, x]
        take = np.isnan(found) & ~blocked & strips.valid[e, place]
        found[take] = strips.disparity[e, place][take]
    return found


def _agreement(across: _Strips, along: _Strips) -> tuple[int, int]:
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
