"""EPI segments: which lines bound one surface, in front of and behind occluders."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.peers.epi_segments import match_segments, opening_sides

# Background, two borders of a surface in front, a line behind it, background.
_POSITION = jnp.asarray([0.0, 24.0, 36.0, 36.0, 60.0])
_SLOPE = jnp.asarray([0.0, 1.0, 1.0, 0.0, 0.0])
_ALL = jnp.ones(5, bool)


def _edges(views, width, lines):
    """Edges along lines in those views where they are said to be seen."""
    edges = np.zeros((views, width))
    for position, slope, seen in lines:
        for u in seen:
            edges[u, round(position + (views // 2 - u) * slope)] = 1
    return jnp.asarray(edges)


def test_the_background_is_matched_beneath_the_surface_in_front():
    opens = jnp.asarray([0, 0, -1, 0, 0])
    found = match_segments(_POSITION, _SLOPE, opens, _ALL, views=9)
    assert found.right.tolist() == [1, 2, 3, 4, -1]
    assert found.disparity.tolist() == [0, 1, 0, 0, 0]
    with pytest.raises(ValueError, match="`views` must be odd and at least 3, got 8"):
        match_segments(_POSITION, _SLOPE, opens, _ALL, views=8)


@pytest.mark.parametrize(("seen", "side"), [(range(5, 9), -1), (range(4), 1)])
def test_the_surface_in_front_is_where_the_line_behind_is_not_seen(seen, side):
    # Line 3 crosses line 2 in the center view: later views see it to the right of line 2.
    edges = _edges(9, 70, [(24, 1, range(9)), (36, 1, range(9)), (36, 0, seen)])
    sides = opening_sides(_POSITION, _SLOPE, edges, _ALL)
    assert sides[2] == side
    assert sides[jnp.asarray([0, 1, 3, 4])].tolist() == [0, 0, 0, 0]


class _Rules:
    """Which lines may bound a segment (Alg. 2), by intercepts and in loops."""

    def __init__(self, position, slope, opens, valid, views=9):
        half = views // 2
        self.first, self.last = position + half * slope, position - half * slope
        self.opens, self.valid, self.count = opens, valid, len(position)

    def cross(self, i, j):
        return (self.first[j] - self.first[i]) * (self.last[j] - self.last[i]) <= 0

    def follows(self, i, j):
        left = self.first[j] < self.first[i] and self.last[j] < self.last[i]
        return i != j and self.valid[i] and self.valid[j] and not left

    def surface(self, i, j):
        facing = self.opens[i] > 0 and self.opens[j] < 0
        return facing and self.follows(i, j) and not self.cross(i, j)

    def occluding(self, i, j):
        """A pair of the first matching, which holds no other surface in between."""
        if not self.follows(i, j) or self.cross(i, j):
            return False
        between = any(
            (self.follows(i, k) and self.surface(k, j))
            or (self.surface(i, k) and self.follows(k, j))
            for k in range(self.count)
        )
        return (self.opens[i] > 0 or self.opens[j] < 0) and not between

    def affinity(self, i, j):
        """(4.7), with the missing half in the midpoints."""
        width = (self.first - self.last)[[i, j]]
        middle = (self.first + self.last)[[i, j]] / 2
        return 1 / (0.15 * abs(width[0] - width[1]) + 0.85 * abs(middle[0] - middle[1]) + 1e-6)


def _best(rules, pairs, i=0, used=frozenset()):
    """The matching of largest sum among all that there are, and its sum."""
    if i == rules.count:
        return 0.0, {}
    best = _best(rules, pairs, i + 1, used)
    for j in range(rules.count):
        if (i, j) in pairs and j not in used:
            rest, chosen = _best(rules, pairs, i + 1, used | {j})
            total = rest + rules.affinity(i, j)
            if total > best[0]:
                best = total, {i: j, **chosen}
    return best


@pytest.mark.parametrize("seed", range(20))
def test_random_segments_are_the_best_of_all_matchings(seed):
    rng = np.random.default_rng(seed)
    position, slope = rng.uniform(0, 30, 6), rng.choice([-0.5, 0.0, 0.5, 1.5], 6)
    slope = slope + rng.uniform(-0.1, 0.1, 6)
    opens, valid = rng.integers(-1, 2, 6), rng.random(6) < 0.9
    rules = _Rules(position, slope, opens, valid)
    every = list(itertools.product(range(6), repeat=2))
    _, chosen = _best(rules, {pair for pair in every if rules.occluding(*pair)})
    ends = set(chosen.values())
    rest = {(i, j) for i, j in every if rules.follows(i, j) and i not in chosen and j not in ends}
    chosen = _best(rules, rest)[1] | chosen
    given = (jnp.asarray(a) for a in (position, slope, opens, valid))
    found = match_segments(*given, views=9)
    assert found.right.tolist() == [chosen.get(i, -1) for i in range(6)]
    farther = [min(slope[i], slope[chosen[i]]) if i in chosen else 0.0 for i in range(6)]
    np.testing.assert_allclose(found.disparity, farther)
