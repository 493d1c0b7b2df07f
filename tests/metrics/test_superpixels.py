"""Scores of superpixels: small cases by hand, and the same written with loops."""

import inspect
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from skimage import measure

from experiments.peers.superpixel_scores import code_scores
from mvedge_jax.metrics.superpixels import labels_per_pixel, superpixel_scores

_LABEL: Any = measure.label


def _one(rows, columns, fill):
    """Labels of one view, from rules per column and row."""
    return jnp.asarray([[[[fill(y, x) for x in range(columns)] for y in range(rows)]]])


def _row(*views):
    """A row of views of one pixel row, from digits."""
    return jnp.asarray([[[[int(c) for c in view]] for view in views]])


def test_accuracy_sums_over_views_and_the_code_takes_the_best_view():
    labels, objects = _row("1111", "1112", "1112"), _row("1111", "2221", "2221")
    scores = superpixel_scores(labels, objects, None)
    code = code_scores(np.asarray(labels), np.asarray(objects), None)
    assert float(scores.accuracy) == pytest.approx(8 / 12)
    assert code["accuracy_code"] == pytest.approx(0.5)


def test_boundary_recall_of_a_pole_that_numbers_cancel_on():
    objects = _one(6, 10, lambda y, x: 1 + (x == 4))
    labels = _one(6, 10, lambda y, x: 1 + (x > 7))
    scores = superpixel_scores(labels, objects, None)
    code = code_scores(np.asarray(labels), np.asarray(objects), None)
    assert code["recall_code"] == pytest.approx(0.5)
    assert float(scores.recall) == pytest.approx(1 / 3)


def test_boundary_recall_of_a_step():
    objects = _one(6, 10, lambda y, x: 1 + (x > 2))
    labels = _one(6, 10, lambda y, x: 1 + (x > 5))
    scores = superpixel_scores(labels, objects, None)
    code = code_scores(np.asarray(labels), np.asarray(objects), None)
    assert code["recall_code"] == pytest.approx(0.5)
    assert float(scores.recall) == pytest.approx(0.5)


def test_undersegmentation_of_a_column():
    objects = _one(4, 6, lambda y, x: int(x > 0))
    labels = _one(4, 6, lambda y, x: 1 + x // 2)
    scores = superpixel_scores(labels, objects, None)
    assert float(scores.undersegmentation) == pytest.approx(0.6)
    assert float(scores.undersegmentation_area) == pytest.approx(1 / 3)
    assert float(scores.undersegmentation_once) == pytest.approx(1 / 6)
    assert float(scores.accuracy) == pytest.approx(5 / 6)


def test_compactness_of_three_boxes():
    labels = _one(6, 6, lambda y, x: 1 if x < 2 else 2 + (y > 2))
    scores = superpixel_scores(labels, None, None)
    code = code_scores(np.asarray(labels), None, None)
    assert float(scores.compactness) == pytest.approx(0.7093, abs=1e-4)
    assert float(scores.compactness_centre) == pytest.approx(0.7093, abs=1e-4)
    assert code["compactness_code"] == pytest.approx(0.5027, abs=1e-4)
    assert float(scores.boundary_density) == pytest.approx((6 + 4) / 60)
    assert np.isnan(scores.accuracy)
    assert np.isnan(scores.self_similarity)


_VIEWS = ("11113322", "11133222", "11331222")


def test_consistency_of_three_views():
    labels = _row(*_VIEWS)
    disparity = (labels == 3).astype(float)
    scores = superpixel_scores(labels, None, disparity)
    code = code_scores(np.asarray(labels), None, np.asarray(disparity))
    assert code["self_similarity_code"] == pytest.approx(0.1852, abs=1e-4)
    assert float(scores.self_similarity) == 0
    assert code["labels_per_pixel_code"] == pytest.approx(1.375)
    assert float(scores.labels_per_pixel) == 1
    assert float(scores.inconsistent) == 0

    wrong = labels.at[0, 2, 0, 7].set(1)
    scores = superpixel_scores(wrong, None, disparity)
    code = code_scores(np.asarray(wrong), None, np.asarray(disparity))
    assert code["self_similarity_code"] == pytest.approx(0.3889, abs=1e-4)
    assert float(scores.self_similarity) == pytest.approx(0.4444, abs=1e-4)
    assert code["labels_per_pixel_code"] == pytest.approx(1.5)
    assert float(scores.labels_per_pixel) == pytest.approx(1.125)
    assert float(scores.inconsistent) == pytest.approx(1 / 14)
    heat = labels_per_pixel(wrong, disparity)
    np.testing.assert_array_equal(heat, [[1, 1, 1, 1, 1, 1, 1, 2]])


def _random(seed, shape=(3, 3, 9, 11)):
    """Blobs, with zeros, of which some labels are missing in some views."""
    rng = np.random.default_rng(seed)
    labels = np.kron(rng.integers(0, 6, (*shape[:2], 3, 4)), np.ones((3, 3), int))[..., :11]
    objects = np.kron(rng.integers(0, 3, (*shape[:2], 5, 6)), np.ones((2, 2), int))[..., :9, :11]
    return labels, objects, np.round(rng.uniform(-1.2, 1.2, shape), 1)


def _brute(labels, objects):
    """Scores of every view by loops over labels and objects."""
    views, truth = labels.reshape(-1, *labels.shape[2:]), objects.reshape(-1, *objects.shape[2:])
    right = sum(
        max(((views == k) & (truth == o)).sum() for o in np.unique(truth))
        for k in np.unique(views)
        if k > 0
    )
    once, ratio, compact, pieces, present = [], [], [], 0, 0
    for view, ids in zip(views, truth, strict=True):
        leak, shares, round_off = (view == 0).sum(), [], 0.0
        for k in np.unique(view):
            on = [((view == k) & (ids == o)).sum() for o in np.unique(ids)]
            leak += sum(on) - max(on) if k else 0
            if k:
                region = np.pad(view == k, 1)
                sides = sum((region[1:-1, 1:-1] & ~np.roll(region, s, a)[1:-1, 1:-1]).sum()
                            for s in (1, -1) for a in (0, 1))  # fmt: skip
                round_off += 4 * np.pi * sum(on) ** 2 / sides**2 / view.size
                pieces += _LABEL(view == k, connectivity=1).max()
                present += 1
        for o in np.unique(ids):
            inside = [((view == k) & (ids == o)).sum() for k in np.unique(view)]
            outside = [((view == k) & (ids != o)).sum() for k in np.unique(view)]
            shares.append(sum(map(min, inside, outside)) / (ids == o).sum())
        once.append(leak / view.size)
        ratio.append(np.mean(shares))
        compact.append(round_off)
    return np.array(
        [right / views.size, np.mean(once), np.mean(ratio), np.mean(compact), pieces / present]
    )


@pytest.mark.parametrize("seed", range(3))
def test_tables_are_those_of_loops(seed):
    labels, objects, _ = _random(seed)
    found = superpixel_scores(jnp.asarray(labels), jnp.asarray(objects), None)
    scores = (
        found.accuracy,
        found.undersegmentation_once,
        found.undersegmentation,
        found.compactness,
        found.pieces,
    )
    np.testing.assert_allclose(scores, _brute(labels, objects), rtol=1e-12)
    assert float(found.unlabelled) == pytest.approx((labels == 0).mean())


def _brute_consistency(labels, disparity):
    rows, columns, height, width = labels.shape
    vc, uc = rows // 2, columns // 2
    differs = seeing = pairs = 0
    distance = 0.0
    for v, u in np.ndindex(rows, columns):
        if (v, u) == (vc, uc):
            continue
        mine, theirs = {}, {}
        for y, x in np.ndindex(height, width):
            d = disparity[vc, uc, y, x]
            a = int(np.floor(x + (uc - u) * d + 0.5))
            b = int(np.floor(y + (vc - v) * d + 0.5))
            if not (0 <= a < width and 0 <= b < height):
                continue
            if abs(disparity[v, u, b, a] - d) > 0.1:
                continue
            label = labels[v, u, b, a]
            seeing += 1
            window = labels[vc, uc, max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            differs += label == 0 or label not in window
            mine.setdefault(labels[vc, uc, y, x], []).append((x, y))
            theirs.setdefault(label, []).append((x, y))
        for k in set(mine) & set(theirs) - {0}:
            distance += np.hypot(*(np.mean(mine[k], 0) - np.mean(theirs[k], 0)))
            pairs += 1
    return distance / pairs, 1 + differs / (height * width), differs / seeing


@pytest.mark.parametrize("seed", range(2))
def test_consistency_is_that_of_loops(seed):
    labels, _, disparity = _random(seed)
    found = superpixel_scores(jnp.asarray(labels), None, jnp.asarray(disparity))
    scores = found.self_similarity, found.labels_per_pixel, found.inconsistent
    np.testing.assert_allclose(scores, _brute_consistency(labels, disparity), rtol=1e-9)


def test_missing_views_do_not_count():
    labels, objects, disparity = (jnp.asarray(a) for a in _random(3, (1, 3, 9, 11)))
    available = jnp.asarray([[False, True, True]])
    part = superpixel_scores(labels, objects, disparity, available=available)
    other = labels.at[0, 0].set(1), objects.at[0, 0].set(0), disparity.at[0, 0].set(0.5)
    again = superpixel_scores(*other, available=available)
    np.testing.assert_array_equal(np.stack(part), np.stack(again))


def test_labels_do_not_depend_on_their_numbers():
    labels, objects, disparity = (jnp.asarray(a) for a in _random(4))
    plain = superpixel_scores(labels, objects, disparity)
    moved = superpixel_scores(7 * labels, 3 + 2 * objects, disparity)
    for name in ("accuracy", "recall", "undersegmentation", "compactness", "inconsistent"):
        assert float(getattr(plain, name)) == pytest.approx(float(getattr(moved, name)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a, b, c: (a[0], b, c), "`labels` must have the axes"),
        (lambda a, b, c: (a, b[:1], c), "`object_ids` must have the shape of `labels`"),
        (lambda a, b, c: (a, b, c[..., :3]), "`disparity` must have the shape of `labels`"),
        (lambda a, b, c: (a - 1, b, c), "`labels` must be at least 0, got -1"),
    ],
)
def test_bad_input_is_named(change, message):
    arrays = change(*(jnp.asarray(a) for a in _random(5)))
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(superpixel_scores)(*arrays)
