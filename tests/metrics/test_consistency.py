"""View consistency: against loops over pixels, planes with known answers, gaps."""

import jax.numpy as jnp
import numpy as np

from experiments.peers.printed_consistency import printed_view_consistency
from mvedge_jax.metrics import view_consistency, view_consistency_map


def _maps(shape=(3, 3, 9, 11)):
    rng = np.random.default_rng(2)
    maps = rng.integers(-1, 2, shape) + 0.2 * rng.normal(size=shape)
    return jnp.asarray(maps)


def _brute_force(maps, target, available):
    """What every view says about each pixel of the target, where its four pixels let it be seen."""
    rows, columns, height, width = maps.shape
    found = [[[] for _ in range(width)] for _ in range(height)]
    for v, u, y, x in np.ndindex(rows, columns, height, width):
        d = maps[target][y, x]
        b, a = y + (target[0] - v) * d + 1e-3, x + (target[1] - u) * d + 1e-3
        if not available[v, u] or not (0 <= a < width and 0 <= b < height):
            continue
        row, column = int(b), int(a)
        four = maps[v, u, row : row + 2, column : column + 2]
        if four.min() <= d + 0.1:
            found[y][x].append(min(max(d, four.min()), four.max()))
    count = np.array([[len(values) for values in row] for row in found])
    variance = np.array([[np.var(v) if v else 0.0 for v in row] for row in found])
    return variance, count


def test_agrees_with_brute_force():
    maps = _maps()
    available = np.ones((3, 3), bool)
    available[0, 2] = False
    scores = view_consistency(maps, available=jnp.asarray(available), crop=1, stride=1)
    assert jnp.isnan(scores.per_view[0, 2])
    expected = []
    for target in ((0, 0), (1, 1), (2, 1)):
        variance, count = _brute_force(np.asarray(maps), target, available)
        ours, number = view_consistency_map(maps, target, available=jnp.asarray(available))
        np.testing.assert_array_equal(number, count)
        np.testing.assert_allclose(ours, variance, atol=1e-12)
        inner = np.s_[1:-1, 1:-1]
        shared = count[inner] >= 2
        expected.append(variance[inner][shared].mean())
        np.testing.assert_allclose(scores.per_view[target], expected[-1])
        np.testing.assert_allclose(scores.covered[target], shared.mean())
    np.testing.assert_allclose(scores.mean, np.nanmean(scores.per_view))


def test_consistent_maps_score_zero_and_a_stray_view_shows():
    # A square at disparity 1 before a background at 0, drawn in every view: integer shifts.
    maps = np.zeros((3, 3, 16, 16))
    for v, u in np.ndindex(3, 3):
        maps[v, u, 5 + 1 - v : 10 + 1 - v, 5 + 1 - u : 10 + 1 - u] = 1
    assert view_consistency(jnp.asarray(maps)).mean == 0
    stray = maps.copy()
    stray[0, 2] += 0.3
    scores = view_consistency(jnp.asarray(stray))
    # One of nine maps is nearer by 0.3: the others show that nothing is there, and the variance is
    # 0.3² 8/81 wherever all nine overlap. They themselves may well be hidden by it.
    np.testing.assert_allclose(scores.per_view[0, 2], 0.09 * 8 / 81, rtol=0.5)
    assert (scores.per_view.at[0, 2].set(0) == 0).all()
    far = maps.copy()
    far[0, 2] -= 0.3
    assert (view_consistency(jnp.asarray(far)).per_view > 0.09 * 8 / 81 * 0.5).sum() >= 8


def test_the_printed_equations_charge_one_constant_for_its_distance_from_zero():
    # At disparity 1 every map lands on whole pixels; all nine reach the middle pixel.
    maps = jnp.ones((3, 3, 7, 7))
    assert view_consistency(maps, crop=2).mean == 0
    np.testing.assert_allclose(printed_view_consistency(maps, crop=2).per_view[1, 1], 9 / 8**3)
    assert printed_view_consistency(0 * maps).mean == 0
    spoilt = printed_view_consistency(maps.at[2, 0, 4, 4].set(jnp.nan))
    assert jnp.isposinf(spoilt.per_view).all()


def test_gaps_are_not_rewarded():
    maps = _maps()
    assert jnp.isposinf(view_consistency(maps.at[2, 0, 4, 4].set(jnp.nan)).per_view).all()
    variance, _ = view_consistency_map(maps.at[1, 1, 4, 4].set(jnp.inf), (1, 1))
    assert jnp.isposinf(variance[4, 4])
    assert jnp.isfinite(variance).sum() == variance.size - 1
    missing = jnp.ones((3, 3), bool).at[2, 0].set(False)
    spoilt = view_consistency(maps.at[2, 0].set(jnp.nan), available=missing)
    np.testing.assert_array_equal(
        spoilt.per_view, view_consistency(maps, available=missing).per_view
    )


def _printed(maps, target, available):
    """(6.9) of a view, every sum as it is printed; NaN where fewer than two maps land."""
    rows, columns, height, width = maps.shape
    landed = np.full((rows * columns, height, width), -np.inf)
    for v, u, y, x in np.ndindex(maps.shape):
        d = maps[v, u, y, x]
        b, a = (
            int(np.floor(p + step * d + 0.5))
            for p, step in ((y, v - target[0]), (x, u - target[1]))
        )
        if available[v, u] and 0 <= b < height and 0 <= a < width:
            landed[v * columns + u, b, a] = max(landed[v * columns + u, b, a], d)
    found = np.full((height, width), np.nan)
    for y, x in np.ndindex(height, width):
        rho = [d for d in landed[:, y, x] if np.isfinite(d)]
        n = len(rho) - 1
        if n >= 1:
            mean = sum(rho) / n
            found[y, x] = sum((d - mean) ** 2 for d in rho) / n
    return found


def test_the_printed_equations_agree_with_loops():
    maps = _maps()
    available = np.ones((3, 3), bool)
    available[0, 2] = False
    scores = printed_view_consistency(maps, available=jnp.asarray(available), crop=1)
    assert jnp.isnan(scores.per_view[0, 2])
    for target in ((0, 0), (1, 1), (2, 1)):
        expected = _printed(np.asarray(maps), target, available)[1:-1, 1:-1]
        np.testing.assert_allclose(scores.per_view[target], np.nanmean(expected))
        np.testing.assert_allclose(scores.covered[target], np.isfinite(expected).mean())


def test_slanted_planes_agree():
    slope = 0.1
    x = np.arange(11) - 5.0
    views = np.arange(3) - 1
    # d(x_c) = slope x_c in the center; at x = x_c - du d in view u, so d = slope x / (1 - slope du)
    maps = np.stack([np.broadcast_to(slope * x / (1 - slope * du), (3, 9, 11)) for du in views], 1)
    assert view_consistency(jnp.asarray(maps), crop=1, stride=1).mean < 1e-9
