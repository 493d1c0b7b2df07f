"""Matching of windows along one view axis, in strips of rows, on the host."""

import dataclasses
import math
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

# Sizes in pixels, contrasts in sRGB units; measured on the benchmark's scenes and a Lytro's.
HEIGHT = 5  # rows that share one disparity, to tell textures apart
WINDOW = 5  # width of a matching window
BEHIND = 0.3  # smallest difference in disparity of a depth edge
_MEMORY = 3e7  # matches of strips, columns and disparities that are held at a time
_SIGMA = 0.7  # of the blur against aliasing
_STEP = 0.3  # px at the outermost view between two disparities that are tried
_TEXTURE = 0.003  # smallest mean absolute deviation in a window that can be matched
_DISTINCT = 0.3  # by how much, in deviations, the next disparity must be worse
_MATCH = 0.5  # how well, in deviations, a window must match


class Views(NamedTuple):
    """The views of one arm of the crosshair.

    Attributes:
        images: the epipolar axis is `x`, `[s, y, x, c]`.
        there: which views are available.
        steps: view steps from the center view, the factors of disparity, float32.
    """

    images: Float[np.ndarray, "s y x c"]
    there: Bool[np.ndarray, " s"]
    steps: Float[np.ndarray, " s"]

    @property
    def middle(self) -> int:
        """Index of the center view."""
        return len(self.there) // 2

    @property
    def farthest(self) -> float:
        """Steps to the outermost view."""
        return float(np.abs(self.steps).max())

    def turned(self) -> "Views":
        """The same with `x` and `y` exchanged."""
        return Views(self.images.transpose(0, 2, 1, 3), self.there, self.steps)

    def halved(self) -> "Views":
        """The same at half the size."""
        height, width = (side // 2 for side in self.images.shape[1:3])
        whole = self.images[:, : 2 * height, : 2 * width]
        halves = [cv2.resize(one, (width, height), interpolation=cv2.INTER_AREA) for one in whole]
        return Views(np.stack(halves), self.there, self.steps)


@dataclasses.dataclass(frozen=True)
class Strips:
    """Matches along one arm at strips of rows: `y` center rows, all columns."""

    y: np.ndarray
    disparity: Float[np.ndarray, "e x"]
    valid: Bool[np.ndarray, "e x"]


@dataclasses.dataclass(frozen=True)
class Matches:
    """Matches along one arm, `through` all views and through the better `half` of them.

    A surface beside an occluder is hidden in the views of one half, but not of the other.
    `missing` is +1 where the views before the center lack the match of `half`, -1 where those
    after it do, 0 where neither; `gradient` is that along x; `everywhere` is where `through` holds
    in every single view.
    """

    through: Strips
    half: Strips
    missing: np.ndarray
    gradient: np.ndarray
    everywhere: np.ndarray


def match(views: Views, reach: float, count: int) -> Matches:
    """Matches windows of at most `count` strips of rows, up to `reach` px per view step."""
    arm, middle, farthest = views.images, views.middle, views.farthest
    height, width = arm.shape[1:3]
    number = 2 * math.ceil(reach * farthest / _STEP) + 1
    count = min(count, height // HEIGHT, max(12, int(_MEMORY / (number * width))))
    y = np.linspace(HEIGHT, height - 1 - HEIGHT, count).astype(int)
    rows = (y[:, None] + np.arange(-(HEIGHT // 2), HEIGHT // 2 + 1)).ravel()
    arm = np.stack([cv2.GaussianBlur(view, (0, 0), _SIGMA)[rows] for view in arm])
    disparities = np.linspace(-reach, reach, number).astype(np.float32)

    def strips(image: np.ndarray) -> np.ndarray:
        gray = cv2.transform(image, np.full((1, image.shape[2]), 1 / image.shape[2], np.float32))
        return gray.reshape(len(y), HEIGHT, width).mean(1)

    pad = math.ceil(reach * farthest) + 1
    padded = [cv2.copyMakeBorder(v, 0, 0, pad, pad, cv2.BORDER_REPLICATE) for v in arm]
    counts = [int(half.sum()) for half in (views.there[:middle], views.there[middle + 1 :])]
    halves = np.zeros((2, number, len(y), width), np.float32)
    worst = np.zeros((number, len(y), width), np.float32)
    for view in np.flatnonzero(views.there):
        if view == middle:
            continue
        for k, disparity in enumerate(disparities):
            shift = float(views.steps[view] * disparity)
            seen = _moved(padded[view], pad + shift, width)
            error = cv2.blur(strips(cv2.absdiff(seen, arm[middle])), (WINDOW, 1))
            outside = slice(max(0, width - math.ceil(shift)), None)
            error[:, outside if shift > 0 else slice(0, math.ceil(-shift))] = 0.5
            halves[int(view > middle), k] += error / counts[int(view > middle)]
            np.maximum(worst[k], error, out=worst[k])
    if min(counts) == 0:  # a half without views copies the other one
        empty = counts.index(0)
        halves[empty] = halves[1 - empty]
    center = arm[middle]
    mean = cv2.blur(center.reshape(len(y), HEIGHT, width, -1).mean(1), (WINDOW, 1))
    deviation = cv2.blur(strips(np.abs(center - np.repeat(mean, HEIGHT, axis=0))), (WINDOW, 1))
    through, best = _best(halves.mean(0), disparities, deviation, y)
    everywhere = np.take_along_axis(worst, best[None], 0)[0] < deviation
    half, best = _best(halves.min(0), disparities, deviation, y)
    before, after = np.take_along_axis(halves, best[None, None], 1)[:, 0] > deviation
    line = center.reshape(len(y), HEIGHT, width, -1).mean(1)
    slope = np.zeros((len(y), width), np.float32)
    slope[:, 1:-1] = np.abs(line[:, 2:] - line[:, :-2]).mean(-1) / 2
    return Matches(through, half, before.astype(int) - after, slope, everywhere)


def _moved(padded: np.ndarray, start: float, width: int) -> np.ndarray:
    """Columns from a place on that may lie between two of them."""
    first = math.floor(start)
    near, far = (padded[:, k : k + width] for k in (first, first + 1))
    return cv2.addWeighted(near, 1 - (start - first), far, start - first, 0)


def _best(
    cost: Float[np.ndarray, "k e x"], disparities: np.ndarray, deviation: np.ndarray, y: np.ndarray
) -> tuple[Strips, np.ndarray]:
    """The disparity of least cost, where it is good and no other is nearly as good."""
    best = cost.argmin(0)
    least = cost.min(0)
    far = np.abs(disparities[:, None, None] - disparities[best]) > BEHIND
    next_best = np.where(far, cost, np.inf).min(0)
    valid = (deviation > _TEXTURE) & (next_best - least > _DISTINCT * deviation)
    valid &= (least < _MATCH * deviation) & (best > 0) & (best < len(disparities) - 1)
    return Strips(y, disparities[best], valid), best
