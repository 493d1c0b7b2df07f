"""Edge points by the thesis' own steps, and its rival of bidirectional diffusion."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.derivatives import noisy_scene
from edges.scenes import plane
from edges.test_occlusion import make_points
from helpers import dot, random_like

from mvedge_jax._crosshair import crosshair
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges.sides._reprojection import reprojection_score
from mvedge_jax.edges.thesis import LineSearch, ThesisEdges
from mvedge_jax.epi import FilterBank
from mvedge_jax.lightfield import LightField

KEY = jax.random.key(0)


def _model(light_field, **fields) -> Any:
    """The preset of the thesis with other edges."""
    model = EdgeDepth.for_light_field(light_field, preset="thesis")
    edges = ThesisEdges(**{"reach": 0.75, "capacity": 512, "filters": 16} | fields)
    return model.replace(edges=edges, searched=(-edges.reach, edges.reach))


@pytest.mark.slow
def test_points_of_a_plane():
    light_field = plane(0.37, views=9, size=(16, 40))
    model = _model(light_field, lines=LineSearch(capacity=16))
    edges = multiview_edges(light_field, model, key=KEY)
    keep = np.asarray(edges.points.valid)
    error = np.abs(np.asarray(edges.points.disparity)[keep] - 0.37)
    assert keep.sum() > 50
    assert int(edges.stats.candidates) >= int(edges.stats.consistent) >= keep.sum()
    # Half the spacing of the filters, and hardly an outlier.
    assert np.median(error) < 0.05
    assert np.mean(error < 0.15) > 0.95
    assert not np.asarray(edges.points.disparity)[~keep].any()


@pytest.mark.slow
def test_taps_reach_the_disparities_of_points_between_filters():
    blind = noisy_scene("edges", 40)
    choices = {"edges.lines.interpolate": True, "edges.lines.capacity": 32}
    model: Any = EdgeDepth.for_light_field(blind, preset="thesis", choices=choices)
    banks = model.edges.prewitt(blind.views.shape, blind.views.dtype)
    taps = [bank.taps for bank in banks]

    @jax.jit
    def loss(taps):
        own = tuple(FilterBank(b.disparity, t) for b, t in zip(banks, taps, strict=True))
        learned = model.replace({"edges.banks": own})
        points = multiview_edges(blind, learned, key=jax.random.key(3)).points
        return jnp.where(points.valid, jnp.sin(3 * points.disparity + points.xy[:, 0]), 0).sum()

    direction = random_like(taps, key=KEY)
    slope = dot(jax.grad(loss)(taps), direction)
    above, below = (
        loss(jax.tree.map(lambda t, d, h=h: t + h * d, taps, direction)) for h in (1e-8, -1e-8)
    )
    assert abs(slope) > 1
    np.testing.assert_allclose(slope, (above - below) / 2e-8, rtol=1e-3)


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
