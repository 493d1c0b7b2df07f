"""Scores of superpixels in the forms of the authors' program, which the thesis' figures are in."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage


def code_scores(
    labels: Int[np.ndarray, "v u y x"],
    object_ids: Int[np.ndarray, "v u y x"] | None,
    disparity: Float[np.ndarray, "v u y x"] | None,
    *,
    available: Bool[np.ndarray, "v u"] | None = None,
) -> dict[str, float]:
    """What the authors' program makes of Eq. 5.2 to 5.4; see `SuperpixelScores` for the others.

    Pixels without a label are one more superpixel.

    Args:
        labels: at least 0; 0 for none.
        object_ids: true objects in every view; None leaves their scores out.
        disparity: true, of every view, px per view step; None leaves out scores of consistency.
        available: views that take part, all by default; the center view has to.

    Returns:
        `accuracy_code`: each superpixel on the object that it has most pixels of in any one view.
        `recall_code`: mean over views; boundaries by Sobel's operator on the numbers of labels.
        `compactness_code`: median of the terms of (5.4) in the center view, with the pixels at the
        border as perimeter. `self_similarity_code`: px between centroids of a label in the center
        view and in any view, of everything in either. `labels_per_pixel_code`: views that do not
        see a pixel disagree.

    Source: the authors' program; Thesis 5.2.3.

    Example:
        >>> labels = np.array([[[[1, 1, 1, 1]]], [[[1, 1, 1, 2]]], [[[1, 1, 1, 2]]]])
        >>> objects = np.array([[[[1, 1, 1, 1]]], [[[2, 2, 2, 1]]], [[[2, 2, 2, 1]]]])
        >>> code_scores(labels, objects, None)["accuracy_code"]
        0.5
    """
    grid = labels.shape[:2]
    center = grid[0] // 2, grid[1] // 2
    use = np.ones(grid, bool) if available is None else np.asarray(available)
    labels = _numbered(np.asarray(labels)) + (np.min(labels) > 0)
    scores = {"compactness_code": _compactness(labels[center])}
    if object_ids is not None:
        scores |= _against(labels[use], _numbered(np.asarray(object_ids))[use])
    if disparity is not None:
        v, u = np.nonzero(use)
        steps = np.stack([center[1] - u, center[0] - v], axis=1)
        scores |= _between(labels[center], labels[use], np.asarray(disparity)[use], steps)
    return scores


def _numbered(ids: np.ndarray) -> np.ndarray:
    return np.unique(ids, return_inverse=True)[1].reshape(ids.shape)


def _compactness(labels: np.ndarray) -> float:
    # What lies beyond the frame is another region.
    padded = np.pad(labels, 1, constant_values=-1)
    inside = padded[1:-1, 1:-1]
    border = np.zeros(labels.shape, bool)
    for beside in (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]):
        border |= beside != inside
    area, length = np.bincount(labels.ravel()), np.bincount(labels.ravel(), border.ravel())
    there = area > 0
    return float(np.median(4 * np.pi * area[there] ** 2 / length[there] ** 2)) / labels.size


def _against(views: np.ndarray, objects: np.ndarray) -> dict[str, float]:
    shape = views.max() + 1, objects.max() + 1
    counts = np.zeros((len(views), *shape), int)
    for table, view, truth in zip(counts, views, objects, strict=True):
        np.add.at(table, (view, truth), 1)
    best = counts.max(0).argmax(1)
    right = counts.sum(0)[np.arange(shape[0]), best].sum()
    rates = []
    for view, truth in zip(views, objects, strict=True):
        wanted = _at_gradients(truth)
        near = ndimage.maximum_filter(_at_gradients(view), size=5, mode="constant")
        rates.append((wanted & near).sum() / wanted.sum() if wanted.any() else np.nan)
    return {"accuracy_code": float(right / counts.sum()), "recall_code": float(np.nanmean(rates))}


def _at_gradients(ids: np.ndarray) -> np.ndarray:
    """Pixels where Sobel's operator finds something in the numbers of labels themselves."""
    p = np.pad(ids, 1, mode="edge")
    tall = p[:-2] + 2 * p[1:-1] + p[2:]
    wide = p[:, :-2] + 2 * p[:, 1:-1] + p[:, 2:]
    return (tall[:, 2:] != tall[:, :-2]) | (wide[2:] != wide[:-2])


def _between(
    center: np.ndarray, views: np.ndarray, disparity: np.ndarray, steps: np.ndarray
) -> dict[str, float]:
    y, x = np.indices(center.shape).astype(disparity.dtype)
    count = int(max(center.max(), views.max())) + 1
    own = _centroids(center, x, y, count)
    distance = labels = differs = 0.0
    for view, truth, step in zip(views, disparity, steps, strict=True):
        moved = x - step[0] * truth, y - step[1] * truth
        other = _centroids(view, *moved, count)
        apart = np.hypot(*(own - other))[1:]
        distance += np.nansum(apart)
        labels += np.isfinite(apart).sum()
        landed = _landed(view, *moved, np.abs(step[0] * truth))
        differs += (~_around(landed, center)).sum()
    similarity = float(distance / labels) if labels else float("nan")
    labels_per_pixel = 1 + float(differs) / center.size
    return {"self_similarity_code": similarity, "labels_per_pixel_code": labels_per_pixel}


def _centroids(labels: np.ndarray, x: np.ndarray, y: np.ndarray, count: int) -> np.ndarray:
    """Mean places per label, `[2, count]`; NaN of labels that are not there."""
    mass = np.bincount(labels.ravel(), minlength=count).astype(float)
    mass[mass == 0] = np.nan
    return np.stack([np.bincount(labels.ravel(), a.ravel(), count) for a in (x, y)]) / mass


def _landed(labels: np.ndarray, x: np.ndarray, y: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """The label that lands on each pixel of the center view, least horizontal motion first."""
    height, width = labels.shape
    column, row = (np.floor(a + 0.5).astype(int) for a in (x, y))
    inside = ((column >= 0) & (column < width) & (row >= 0) & (row < height)).T.ravel()
    # Among equals the first in order of columns.
    order = np.argsort(motion.T.ravel()[inside], kind="stable")[::-1]
    landed = np.zeros_like(labels)
    place = row.T.ravel()[inside][order], column.T.ravel()[inside][order]
    landed[place] = labels.T.ravel()[inside][order]
    return landed


def _around(label: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Whether a label is among those of the 3x3 pixels around each."""
    height, width = labels.shape
    padded = np.pad(labels, 1, constant_values=-1)
    windows = (padded[y : y + height, x : x + width] for y in range(3) for x in range(3))
    return np.any([window == label for window in windows], axis=0)
