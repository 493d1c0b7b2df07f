"""Scores of superpixels in all views (Thesis 5.2.3): accuracy, shape, consistency."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from mvedge_jax._params import accepts_numpy

from ._label_consistency import agreement
from ._segments import overlap, recalled, shape_of, table


class SuperpixelScores(NamedTuple):
    """Scores of superpixels; see `superpixel_scores`. Lengths are in px.

    NaN is what cannot be told without the object ids, the disparity, or other views. The forms of
    the authors' program, which the figures of the thesis are in, are in
    `experiments/peers/superpixel_scores.py`.

    Attributes:
        accuracy: achievable accuracy, share of pixels, each superpixel on the object that it has
            most pixels of in all views together.
        recall: boundary recall (5.2), pooled over views; boundaries are where labels of neighbors
            differ, on both sides.
        undersegmentation: (5.3), mean over objects and views.
        undersegmentation_area: leaks over pixels, counted for both objects; mean over views.
        undersegmentation_once: the same, each leak once.
        compactness: (5.4) as printed, 0..1, with the sides of pixels as perimeter, mean over views.
        compactness_center: of the center view.
        self_similarity: px between centroids of a label in the center view and in another one, of
            what both see; mean over labels and views.
        labels_per_pixel: 1 + number of views that see a pixel of the center view and give it a
            label that is not within 1 px of it.
        inconsistent: share of the pairs of a pixel and another view seeing it that disagree.
        boundary_density: share of neighboring pixels with different labels, mean over views.
        unlabeled: share of pixels without a label.
        number: labels in all views together.
        number_connected: connected pieces in the center view.
        pieces: connected pieces per label and view that has it.
        hidden: labels that the center view lacks.
        small: labels with 1 to 9 px in the center view.
        size: mean square root of the area in the center view, px.
    """

    accuracy: Float[Array, ""]
    recall: Float[Array, ""]
    undersegmentation: Float[Array, ""]
    undersegmentation_area: Float[Array, ""]
    undersegmentation_once: Float[Array, ""]
    compactness: Float[Array, ""]
    compactness_center: Float[Array, ""]
    self_similarity: Float[Array, ""]
    labels_per_pixel: Float[Array, ""]
    inconsistent: Float[Array, ""]
    boundary_density: Float[Array, ""]
    unlabeled: Float[Array, ""]
    number: Int[Array, ""]
    number_connected: Int[Array, ""]
    pieces: Float[Array, ""]
    hidden: Int[Array, ""]
    small: Int[Array, ""]
    size: Float[Array, ""]


@accepts_numpy
def superpixel_scores(
    labels: Int[Array, "v u y x"],
    object_ids: Int[Array, "v u y x"] | None,
    disparity: Float[Array, "v u y x"] | None,
    *,
    available: Bool[Array, "v u"] | None = None,
) -> SuperpixelScores:
    """Scores superpixels of all views.

    Pixels without a label are wrong, and no label of theirs agrees with any.

    Args:
        labels: `[v, u, y, x]`, at least 0; 0 for none. Of one view alone, `[1, 1, y, x]`.
        object_ids: true objects in every view, at least 0; None leaves their scores out.
        disparity: true, of every view, px per view step; None leaves out scores of consistency.
        available: views that take part, all by default; the center view has to.

    Returns:
        The scores. Not differentiable, nor for `jit`: the number of labels sets shapes.

    Raises:
        ValueError: if shapes do not fit together, or labels or ids are negative.

    Source: Thesis 5.2.3, Eq. 5.2-5.4.

    Example:
        >>> import jax.numpy as jnp
        >>> labels = jnp.array([[[[1, 1, 1, 1]]], [[[1, 1, 1, 2]]], [[[1, 1, 1, 2]]]])
        >>> objects = jnp.array([[[[1, 1, 1, 1]]], [[[2, 2, 2, 1]]], [[[2, 2, 2, 1]]]])
        >>> superpixel_scores(labels, objects, None).accuracy.round(4).item()
        0.6667
    """
    available = _check(labels, object_ids, disparity, available)
    labels, count = _compact(labels, keep=0)
    kinds = 0
    if object_ids is not None:
        object_ids, kinds = _compact(object_ids)
    # Scenes with about as many labels share a compiled program.
    count, kinds = (-(-number // 64) * 64 for number in (count, kinds))
    return _scores(labels, object_ids, disparity, available, count=count, kinds=kinds)


@accepts_numpy
def labels_per_pixel(
    labels: Int[Array, "v u y x"],
    disparity: Float[Array, "v u y x"],
    *,
    available: Bool[Array, "v u"] | None = None,
) -> Float[Array, "y x"]:
    """How many views label a pixel of the center view otherwise, plus one: Fig. 5.9.

    Args:
        labels: see `superpixel_scores`.
        disparity: true, of every view, px per view step.
        available: views that take part, all by default.

    Returns:
        `[y, x]`: 1 + number of views that see the pixel and disagree, as in
        `SuperpixelScores.labels_per_pixel`. Errors are those of `superpixel_scores`.

    Example:
        >>> import jax.numpy as jnp
        >>> labels = jnp.array([[[[1, 1, 1, 2]], [[1, 1, 1, 1]], [[1, 1, 1, 1]]]])
        >>> labels_per_pixel(labels, jnp.zeros((1, 3, 1, 4))).tolist()
        [[1.0, 1.0, 1.0, 2.0]]
    """
    available = _check(labels, None, disparity, available)
    labels, count = _compact(labels, keep=0)
    differs = _agreement(labels, disparity, available, count=-(-count // 64) * 64).differs
    return 1 + differs.astype(disparity.dtype)


_agreement = jax.jit(agreement, static_argnames="count")


def _check(
    labels: Array, object_ids: Array | None, disparity: Array | None, available: Array | None
) -> Array:
    if labels.ndim != 4:
        raise ValueError(
            f"`labels` must have the axes [v, u, y, x], one map per view, got shape {labels.shape}."
        )
    for name, other in (("object_ids", object_ids), ("disparity", disparity)):
        if other is not None and other.shape != labels.shape:
            raise ValueError(
                f"`{name}` must have the shape of `labels`, {labels.shape}, got {other.shape}."
            )
    grid = labels.shape[:2]
    if available is not None and available.shape != grid:
        raise ValueError(
            f"`available` must have the shape of the view grid {grid}, got {available.shape}."
        )
    for name, ids in (("labels", labels), ("object_ids", object_ids)):
        if ids is not None and int(jnp.min(ids)) < 0:
            raise ValueError(f"`{name}` must be at least 0, got {int(jnp.min(ids))}.")
    return jnp.ones(grid, bool) if available is None else available


def _compact(ids: Array, *, keep: int | None = None) -> tuple[Array, int]:
    """Renumbers ids in their order from 0 on, `keep` kept whether there or not; how many."""
    ids = ids.astype(jnp.int32)
    there = jnp.zeros(int(jnp.max(ids)) + 1, bool).at[ids.ravel()].set(True)
    there = there if keep is None else there.at[keep].set(True)
    rank = jnp.cumsum(there, dtype=jnp.int32) - 1
    return rank[ids], int(rank[-1]) + 1


@partial(jax.jit, static_argnames=("count", "kinds"))
def _scores(labels, object_ids, disparity, available, *, count, kinds) -> SuperpixelScores:
    dtype = jnp.result_type(float) if disparity is None else disparity.dtype
    height, width = labels.shape[2:]
    use = available.ravel()
    weight = use.astype(dtype) / jnp.sum(use).astype(dtype)
    maps = labels.reshape(-1, height, width)
    middle = maps.shape[0] // 2

    shapes = lax.map(lambda view: shape_of(view, count, dtype), maps)
    known: dict[str, Array] = dict.fromkeys((*_OF_OBJECTS, *_OF_VIEWS), jnp.asarray(jnp.nan, dtype))
    if object_ids is not None:
        known |= _against(maps, object_ids, use, count, kinds, dtype)
    if disparity is not None:
        known |= _between(labels, disparity, available, count)

    def total(numbers: Array) -> Array:
        return jnp.sum(jnp.where(use, numbers, 0)).astype(dtype)

    there = jnp.zeros(count, bool).at[jnp.where(use[:, None, None], maps, 0)].set(True)
    area = jnp.zeros(count, jnp.int32).at[maps[middle]].add(1)[1:]
    there, seen = there[1:], area > 0
    none = jnp.mean(maps == 0, axis=(1, 2), dtype=dtype)
    return SuperpixelScores(
        **known,
        compactness=jnp.sum(weight * shapes.compactness),
        compactness_center=shapes.compactness[middle],
        boundary_density=jnp.sum(weight * shapes.density),
        unlabeled=jnp.sum(weight * none),
        number=jnp.sum(there, dtype=jnp.int32),
        number_connected=shapes.pieces[middle],
        pieces=total(shapes.pieces) / total(shapes.present),
        hidden=jnp.sum(there & ~seen, dtype=jnp.int32),
        small=jnp.sum(seen & (area < 10), dtype=jnp.int32),
        size=jnp.sum(jnp.sqrt(area.astype(dtype))) / jnp.sum(seen).astype(dtype),
    )


# In the order in which they are made.
_OF_OBJECTS = (
    "accuracy",
    "recall",
    "undersegmentation",
    "undersegmentation_area",
    "undersegmentation_once",
)
_OF_VIEWS = ("self_similarity", "labels_per_pixel", "inconsistent")


def _against(maps, object_ids, use, count, kinds, dtype) -> dict[str, Array]:
    """Accuracy, recall and undersegmentation."""
    objects = object_ids.reshape(maps.shape)

    def one(summed: Array, item: tuple[Array, ...]):
        view, truth, there = item
        counts = jnp.where(there, table(view, truth, (count, kinds)), 0)
        hits = jnp.where(there, jnp.stack(recalled(view, truth)), 0)
        return summed + counts, (overlap(counts, dtype), hits)

    start = jnp.zeros((count, kinds), jnp.int32)
    summed, (leaks, hits) = lax.scan(one, start, (maps, objects, use))
    right = jnp.sum(jnp.max(summed[1:], axis=1)).astype(dtype)
    found, wanted = jnp.sum(hits, axis=0).astype(dtype)
    scores = [
        right / jnp.sum(summed).astype(dtype),
        found / wanted,
        *(jnp.sum(jnp.where(use, leak, 0)) / jnp.sum(use).astype(dtype) for leak in leaks),
    ]
    return dict(zip(_OF_OBJECTS, scores, strict=True))


def _between(labels, disparity, available, count) -> dict[str, Array]:
    """Self-similarity, labels per pixel and the share of inconsistent pairs."""
    found = agreement(labels, disparity, available, count=count)
    dtype = disparity.dtype
    seen, differs = (jnp.sum(a).astype(dtype) for a in (found.seen, found.differs))
    similarity = found.distance / found.labels.astype(dtype)
    scores = [similarity, 1 + differs / found.seen.size, differs / seen]
    return dict(zip(_OF_VIEWS, scores, strict=True))
