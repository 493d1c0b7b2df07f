"""Scores of superpixels: small cases by hand, and the same written with loops."""

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


BOXES = 16 * np.pi * (1 / 16**2 + 2 / 14**2)
CASES = {
    # Sums over views; the code takes the best view.
    "accuracy": (
        _row("1111", "1112", "1112"),
        _row("1111", "2221", "2221"),
        {"accuracy": 8 / 12, "accuracy_code": 0.5},
    ),
    # On which the numbers of recall cancel.
    "pole": (
        _one(6, 10, lambda y, x: 1 + (x > 7)),
        _one(6, 10, lambda y, x: 1 + (x == 4)),
        {"recall_code": 0.5, "recall": 1 / 3},
    ),
    "step": (
        _one(6, 10, lambda y, x: 1 + (x > 5)),
        _one(6, 10, lambda y, x: 1 + (x > 2)),
        {"recall_code": 0.5, "recall": 0.5},
    ),
    "column": (
        _one(4, 6, lambda y, x: 1 + x // 2),
        _one(4, 6, lambda y, x: int(x > 0)),
        {"undersegmentation_area": 1 / 3},
    ),
    "boxes": (
        _one(6, 6, lambda y, x: 1 if x < 2 else 2 + (y > 2)),
        None,
        {"compactness_center": BOXES, "compactness_code": 0.16 * np.pi, "boundary_density": 1 / 6,
         "accuracy": np.nan, "self_similarity": np.nan},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_small_cases(name):
    labels, objects, expected = CASES[name]
    scores = superpixel_scores(labels, objects, None)
    code = code_scores(np.asarray(labels), None if objects is None else np.asarray(objects), None)
    for name, value in expected.items():
        found = code[name] if name in code else getattr(scores, name)
        assert float(found) == pytest.approx(value, nan_ok=True), name


def test_consistency_of_three_views():
    labels = _row("11113322", "11133222", "11331222")
    wrong, disparity = labels.at[0, 2, 0, 7].set(1), (labels == 3).astype(float)
    for shown, expected in (
        (labels, (5 / 27, 1.375, 0, 1, 0)),
        (wrong, (7 / 18, 1.5, 4 / 9, 1.125, 1 / 14)),
    ):
        scores = superpixel_scores(shown, None, disparity)
        code = code_scores(np.asarray(shown), None, np.asarray(disparity))
        found = [code[name] for name in ("self_similarity_code", "labels_per_pixel_code")]
        found += [scores.self_similarity, scores.labels_per_pixel, scores.inconsistent]
        np.testing.assert_allclose([float(value) for value in found], expected, rtol=1e-6)
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
    names = ("accuracy", "undersegmentation_once", "undersegmentation", "compactness", "pieces")
    scores = [getattr(found, name) for name in names]
    np.testing.assert_allclose(scores, _brute(labels, objects), rtol=1e-12)
    assert float(found.unlabeled) == pytest.approx((labels == 0).mean())


def test_missing_views_do_not_count():
    labels, objects, disparity = (jnp.asarray(a) for a in _random(3))
    available = jnp.ones((3, 3), bool).at[0, 0].set(False)
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
