"""Edge points by the thesis' own steps, and its rival of bidirectional diffusion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.derivatives import noisy_scene
from edges.scenes import plane

from mvedge_jax._crosshair import crosshair
from mvedge_jax.depth import EdgeDepth, multiview_edges
from mvedge_jax.edges import EdgePoints
from mvedge_jax.edges.sides import thesis_response
from mvedge_jax.edges.sides._reprojection import reprojection_score
from mvedge_jax.edges.thesis import LineSearch, ThesisEdges
from mvedge_jax.epi import FilterBank
from mvedge_jax.lightfield import LightField


def _model(light_field, **fields):
    """The preset of the thesis with other edges."""
    model = EdgeDepth.for_light_field(light_field, preset="thesis")
    edges = ThesisEdges(**{"reach": 0.75, "capacity": 512, "filters": 16} | fields)
    return model.replace(edges=edges, searched=(-edges.reach, edges.reach))


@pytest.mark.slow
def test_points_of_a_plane():
    light_field = plane(0.37, views=9, size=(16, 40))
    model = _model(light_field, lines=LineSearch(capacity=16))
    edges = multiview_edges(light_field, model, key=jax.random.key(0))
    keep = np.asarray(edges.points.valid)
    error = np.abs(np.asarray(edges.points.disparity)[keep] - 0.37)
    assert keep.sum() > 50
    assert int(edges.stats.candidates) >= int(edges.stats.consistent) >= keep.sum()
    # Half the spacing of the filters, and hardly an outlier.
    assert np.median(error) < 0.05
    assert np.mean(error < 0.15) > 0.95
    assert not np.asarray(edges.points.disparity)[~keep].any()


def test_taps_reach_the_disparities_of_points_between_filters():
    blind = noisy_scene("edges", 40)
    choices = {"edges.lines.interpolate": True, "edges.lines.capacity": 32}
    model = EdgeDepth.for_light_field(blind, preset="thesis", choices=choices)
    assert isinstance(model.edges, ThesisEdges)
    banks = model.edges.prewitt(blind.views.shape, blind.views.dtype)

    def loss(banks):
        learned = model.replace({"edges.banks": banks})
        points = multiview_edges(blind, learned, key=jax.random.key(3)).points
        return jnp.where(points.valid, jnp.sin(3 * points.disparity + points.xy[:, 0]), 0).sum()

    taps = [bank.taps for bank in banks]
    zero = [jnp.zeros_like(bank.disparity) for bank in banks]
    directions = [
        jnp.asarray(np.random.default_rng(k).normal(size=t.shape)) for k, t in enumerate(taps)
    ]
    tangent = tuple(FilterBank(*pair) for pair in zip(zero, directions, strict=True))

    def along(step):
        return jax.tree.map(lambda leaf, change: leaf + step * change, banks, tangent)

    slopes = jax.grad(loss)(banks)
    slope = sum(
        jnp.vdot(s.taps, direction) for s, direction in zip(slopes, directions, strict=True)
    )
    numeric = (loss(along(1e-8)) - loss(along(-1e-8))) / 2e-8
    assert abs(float(slope)) > 1
    np.testing.assert_allclose(slope, numeric, rtol=1e-3)


def test_a_bank_for_other_views_is_refused():
    light_field = plane(0.37, views=9, size=(16, 16))
    model = _model(light_field, capacity=64)
    assert isinstance(model.edges, ThesisEdges)
    model = model.replace({"edges.banks": model.edges.prewitt((5, 5))})
    with pytest.raises(ValueError, match="`bank` is for 5 views, `arm` has 9"):
        multiview_edges(light_field, model, key=jax.random.key(0))


def test_a_missing_key_is_named():
    light_field = plane(0.37, size=(16, 16))
    with pytest.raises(ValueError, match=r"`key` must be given for the entropy search"):
        multiview_edges(light_field, _model(light_field))


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"edges.lines.capacity": 0}, "`capacity` must be at least 1, got 0"),
        ({"edges.lines.levels": 3}, r"`levels` must be one of \(1, 2\), got 3"),
        ({"edges.filters": 3}, "`filters` must be at least 4, got 3"),
        ({"edges.reach": 0.0}, "`reach` must be positive, got 0.0"),
    ],
)
def test_static_fields_that_cannot_be_are_refused(choices, message):
    with pytest.raises(ValueError, match=message):
        _model(plane(0.37, size=(16, 16))).replace(choices)


def test_profiles_are_stretched_before_the_thesis_filter_answers():
    before = jnp.array([0.0, 0, 0, 1, 1, 1, 1])[:, None]
    flat = jnp.full((7, 1), 0.4)
    found = thesis_response(jnp.concatenate([0.003 * before, -0.6 * before, flat], 1))
    np.testing.assert_allclose(found, [4.0, 4.0, 0.0], atol=1e-9)


def test_reprojection_prefers_the_map_that_explains_the_views():
    rng = np.random.default_rng(0)
    texture = rng.uniform(size=(20, 30))
    views = np.zeros((3, 3, 20, 24, 3))
    for v, u in np.ndindex(3, 3):
        # Disparity 1: a point at x is at x + (1 - u).
        views[v, u] = np.roll(texture, (1 - v, 1 - u), (0, 1))[:, 3:27, None]
    horizontal, vertical = crosshair(LightField(jnp.asarray(views)))
    points = EdgePoints(
        xy=jnp.asarray([[10.0, 9.0], [14.0, 6.0]]),
        disparity=jnp.ones(2),
        confidence=jnp.full(2, 0.5),
        error=jnp.full(2, 0.005),
        normal=jnp.asarray([[1.0, 0.0], [0.0, 1.0]]),
        visible=jnp.ones((2, 6), bool),
        valid=jnp.ones(2, bool),
    )
    right, wrong = jnp.ones((20, 24)), jnp.zeros((20, 24))
    score = reprojection_score(points, right, wrong, horizontal, vertical, radius=2)
    assert (np.asarray(score) > 0.05).all()
