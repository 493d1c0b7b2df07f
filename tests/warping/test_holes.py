"""What lies around the holes of a map."""

import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.warping import holes

_TOLERANCE = 0.3


def _around(disparity, hit, y, x):
    """The nearest pixels that were hit: to the left, to the right, above, below; or None."""
    found = []
    for dy, dx in ((0, -1), (0, 1), (-1, 0), (1, 0)):
        v, u = y + dy, x + dx
        while 0 <= v < hit.shape[0] and 0 <= u < hit.shape[1] and not hit[v, u]:
            v, u = v + dy, u + dx
        inside = 0 <= v < hit.shape[0] and 0 <= u < hit.shape[1]
        found.append((v, u, disparity[v, u], abs(v - y) + abs(u - x)) if inside else None)
    return found


def _row(hit, y, step):
    """The nearest row above or below with a pixel that was hit, or None."""
    y += step
    while 0 <= y < hit.shape[0]:
        if hit[y].any():
            return y
        y += step
    return None


@pytest.mark.parametrize("shape", [(9, 1), (7, 12)])
@pytest.mark.parametrize("share", [0.0, 0.03, 0.1, 0.5, 0.9, 1.0])
def test_holes_are_those_of_a_walk_from_each_pixel(shape, share):
    rng = np.random.default_rng(0)
    # What is not hit must not be read.
    hit = rng.random(shape) < share
    disparity = np.where(hit, rng.normal(size=shape), np.nan)
    found = holes(jnp.asarray(disparity), jnp.asarray(hit), tolerance=_TOLERANCE)
    for y, x in np.ndindex(shape):
        behind, spread, crack = (np.asarray(a)[y, x] for a in found)
        own = y * shape[1] + x
        if hit[y, x]:
            assert (behind, spread, crack) == (own, 0, False)
            continue
        around = _around(disparity, hit, y, x)
        known = [place for place in around if place is not None]
        if not known:
            beside = [r for r in (_row(hit, y, -1), _row(hit, y, 1)) if r is not None]
            expected = (0, 0, False)
            if beside:
                sources = [(np.asarray(found.behind)[r, x], r) for r in beside]
                source, row = min(sources, key=lambda s: disparity.ravel()[s[0]])
                expected = (source, np.asarray(found.spread)[row, x], False)
            assert (behind, spread, crack) == expected
            continue
        v, u, farthest, _ = min(known, key=lambda place: place[2])
        values = [place[2] for place in known]
        assert behind == v * shape[1] + u
        assert disparity[v, u] == farthest
        assert spread == pytest.approx(max(values) - min(values))
        pairs = [(around[0], around[1]), (around[2], around[3])]
        expected = any(
            a is not None and b is not None and a[3] == b[3] == 1 and abs(a[2] - b[2]) <= _TOLERANCE
            for a, b in pairs
        )
        assert crack == expected
