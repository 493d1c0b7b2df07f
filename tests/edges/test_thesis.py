"""The named methods of the thesis, each against brute force or a closed form."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from edges.scenes import plane
from edges.test_occlusion import make_points
from epi.slices import STEPS, VIEWS, WIDTH, epi_lines, smooth, step

from mvedge_jax._crosshair import crosshair
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges.sides._reprojection import reprojection_score
from mvedge_jax.edges.thesis import LineSearch, ThesisEdges, joint_filter
from mvedge_jax.edges.thesis._alignment import (
    aligned_count,
    alignment,
    line_visibility,
    longest_run,
)
from mvedge_jax.edges.thesis._entropy import line_entropy
from mvedge_jax.edges.thesis._lines import arm_lines
from mvedge_jax.edges.thesis._vote import spatial_vote
from mvedge_jax.epi import bank_radius, exponential_disparities, prewitt_bank
from mvedge_jax.lightfield import LightField


def test_runs_and_counts_are_those_of_plain_loops():
    rng = np.random.default_rng(3)
    cosine = rng.choice([0.1, 0.99], size=(20, VIEWS))
    runs, counts = (of(jnp.asarray(cosine)) for of in (longest_run, aligned_count))
    for row, run, count in zip(cosine, runs, counts, strict=True):
        text = "".join("x" if value > 0.9 else " " for value in row)
        assert int(run) == max((len(part) for part in text.split()), default=0)
        assert int(count) == text.count("x")


def test_k_and_both_angles_are_numbers_of_the_search():
    # Two crossing edges, under noise, in two equal rows.
    epi = 40 * step(20.0, 0.9) + 50 * step(24.0, -0.4)
    noise = np.random.default_rng(0).normal(size=(VIEWS, 2, WIDTH))
    lab = jnp.asarray(np.stack([epi, epi], 1) + noise)[..., None]
    tried = jnp.asarray(exponential_disparities(12, 1.2))
    bank = prewitt_bank(tried, VIEWS, bank_radius(1.2, VIEWS))
    run = jax.jit(lambda search: arm_lines(lab, bank, search, key=None))

    def found(**numbers):
        search = LineSearch(capacity=24, levels=1, vote=False, entropy=False)
        names, values = zip(*numbers.items(), strict=True) if numbers else ((), ())
        values = [jnp.asarray(value) for value in values]
        return run(eqx.tree_at(lambda s: [getattr(s, n) for n in names], search, values))

    usual = found()
    assert usual.keep.sum() >= 4
    # k of nothing keeps every line, k beyond all views none; so does an angle of 0.
    assert found(aligned=0.0).keep.sum() > usual.keep.sum()
    assert found(aligned=1.01).keep.sum() == 0
    assert found(aligned_angle=0.0).keep.sum() == 0
    wide = found(aligned_angle=np.pi / 4).keep.sum()
    assert usual.keep.sum() <= wide <= found(aligned=0.0).keep.sum()
    # A line is seen in fewer views where the angle is narrower, and in none where it is 0.
    narrow = found(visible_angle=np.pi / 40).visible.sum()
    assert 0 < narrow < usual.visible.sum()
    assert found(visible_angle=0.0).visible.sum() == 0


def test_a_line_is_hidden_where_a_nearer_one_covers_it():
    far, near, width = (32.0, -0.5), (26.0, 1.2), 6.0
    back = 20 + 50 * step(*far)
    cover = step(*near) - step(near[0] + width, near[1])
    epi = jnp.asarray(smooth((cover * 95 + (1 - cover) * back)[..., None])[..., 0])
    lines = epi_lines([far[0], near[0], near[0] + width], [far[1], near[1], near[1]])
    cosine = alignment(epi, lines)
    tested, crossed = (
        np.asarray(line_visibility(cosine, lines, width=WIDTH, tested=of))
        for of in ("all", "crossed")
    )
    gap = far[0] + STEPS * far[1] - near[0] - STEPS * near[1]
    hidden = (gap > 1) & (gap < width - 1)
    assert hidden.any()
    for visible in (tested, crossed):
        assert not visible[0][hidden].any()
        assert visible[0][(gap < -2.5) | (gap > width + 2.5)].all()
    # Only crossed lines are tested: the nearest is not.
    assert crossed[1].all()
    np.testing.assert_array_equal(tested, np.asarray(cosine) > np.cos(np.pi / 10))


def test_entropy_is_that_of_the_histogram():
    samples = np.random.default_rng(4).uniform(0.2, 1, size=(5, 15))
    for row, value in zip(samples, line_entropy(jnp.asarray(samples), bins=16), strict=True):
        counts = np.bincount(np.clip((row / row.max() * 16).astype(int), 0, 15))
        share = counts[counts > 0] / 15
        assert float(value) == pytest.approx(-(share * np.log2(share)).sum(), abs=1e-12)


def test_the_spatial_vote_is_that_of_plain_loops():
    rng = np.random.default_rng(6)
    shape = (64, 96)
    disparity = rng.choice([0.0, 0.1, 0.5], size=shape)
    confidence, present = rng.uniform(size=shape), rng.uniform(size=shape) < 0.4
    found = spatial_vote(*map(jnp.asarray, (disparity, confidence, present, 0.125)))
    half_y, half_x = 64 // 30, 96 // 30
    for y, x in [(0, 0), (30, 40), (63, 95), (10, 50)]:
        window = np.s_[max(y - half_y, 0) : y + half_y + 1, max(x - half_x, 0) : x + half_x + 1]
        same = present[window] & (np.abs(disparity[window] - disparity[y, x]) < 0.125)
        area = (2 * half_y + 1) * (2 * half_x + 1)
        expected = confidence[y, x] / confidence[present].max() * same.sum() / area
        assert float(found[y, x]) == pytest.approx(expected if present[y, x] else 0, abs=1e-12)


def test_the_joint_filter_is_that_of_plain_loops():
    rng = np.random.default_rng(7)
    shape = (9, 11)
    d, color = rng.normal(scale=0.1, size=shape), rng.uniform(size=(*shape, 3))
    present = rng.uniform(size=shape) < 0.5
    sigma = (2.0, 0.1, 0.5)
    y, x = np.indices(shape).reshape(2, -1)
    # One point per pixel, not in its middle, in some slots.
    xy = np.stack([x, y], 1) + rng.uniform(-0.4, 0.4, (x.size, 2))
    given = map(jnp.asarray, (xy, d.reshape(-1), present.reshape(-1), color, *sigma))
    found = joint_filter(*given, radius=3).reshape(shape)
    for y, x in np.ndindex(shape):
        total = weight = 0.0
        for j, i in np.ndindex(shape):
            if (j, i) == (y, x) or max(abs(j - y), abs(i - x)) > 3 or not present[j, i]:
                continue
            squares = (
                ((j - y) ** 2 + (i - x) ** 2) / sigma[0] ** 2
                + (d[j, i] - d[y, x]) ** 2 / sigma[1] ** 2
                + ((color[j, i] - color[y, x]) ** 2).sum() / sigma[2] ** 2
            )
            w = np.exp(-0.5 * squares)
            total, weight = total + w * d[j, i], weight + w
        expected = total / weight if present[y, x] and weight > 1e-6 else d[y, x]
        assert float(found[y, x]) == pytest.approx(expected, abs=1e-12)


KEY = jax.random.key(0)


def _model(light_field, **fields) -> Any:
    """The preset of the thesis with other edges."""
    model = EdgeDepth.for_light_field(light_field, preset="thesis")
    edges = ThesisEdges(**{"reach": 0.75, "capacity": 512, "filters": 16} | fields)
    return model.replace(edges=edges, searched=(-edges.reach, edges.reach))


def _for_other_views(light_field):
    model = _model(light_field, capacity=64)
    return model.replace({"edges.banks": model.edges.prewitt((5, 5))})


@pytest.mark.parametrize(
    ("make", "key", "match"),
    [
        (_for_other_views, KEY, "`bank` is for 5 views, `arm` has 9"),
        (_model, None, r"`key` must be given for the entropy search"),
        *(
            (lambda field, change=change: _model(field).replace(change), KEY, match)
            for change, match in (
                ({"edges.lines.capacity": 0}, "`capacity` must be at least 1, got 0"),
                ({"edges.lines.levels": 3}, r"`levels` must be one of \(1, 2\), got 3"),
                ({"edges.filters": 3}, "`filters` must be at least 4, got 3"),
                ({"edges.reach": 0.0}, "`reach` must be positive, got 0.0"),
            )
        ),
    ],
)
def test_what_cannot_be_is_refused(make, key, match):
    light_field = plane(0.37, views=9, size=(16, 16))
    with pytest.raises(ValueError, match=match):
        multiview_edges(light_field, make(light_field), key=key)


def test_reprojection_prefers_the_map_that_explains_the_views():
    texture = np.random.default_rng(0).uniform(size=(20, 30))
    views = np.zeros((3, 3, 20, 24, 3))
    for v, u in np.ndindex(3, 3):
        # Disparity 1: a point at x is at x + (1 - u).
        views[v, u] = np.roll(texture, (1 - v, 1 - u), (0, 1))[:, 3:27, None]
    points = make_points([[10.0, 9.0], [14.0, 6.0]], [1.0, 1.0], np.eye(2))
    right, wrong = jnp.ones((20, 24)), jnp.zeros((20, 24))
    arms = crosshair(LightField(jnp.asarray(views)))
    score = reprojection_score(points, right, wrong, *arms, radius=2)
    assert (np.asarray(score) > 0.05).all()
