"""The chain as the authors' program has it: its parts keep their protocols, and it gives a map."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.parts import check_part, given
from edges.scenes import plane
from helpers import shared_data

from experiments.peers import authors
from mvedge_jax._crosshair import crosshair
from mvedge_jax._params import cast
from mvedge_jax.datasets import load_light_field
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry import CalibratedViews, Evidence
from mvedge_jax.photometry.brightness import Exposure, Noise


@pytest.mark.slow
def test_parts_keep_their_protocols():
    case = given()
    found = check_part(
        authors.AuthorsSides(),
        lambda p, of: (p(of.points, of.evidence).surface.forward, p(of.points, of.evidence).edge),
    )
    assert all(bool(jnp.isfinite(array).all()) for array in found)
    labels = authors.AuthorsLabels()(case.points, case.sides, case.evidence, case.precision)
    assert float(labels.weight.max()) <= 1
    assert not np.asarray(labels.value)[np.asarray(labels.weight) == 0].any()


def test_the_sweep_finds_the_disparity_of_a_surface():
    field = plane(0.4, views=9, size=(32, 40))
    guide = jnp.moveaxis(field.centre_view, -1, 0)
    one = jnp.ones(())
    same = Exposure(one, jnp.ones((9, 9)))
    views = CalibratedViews(crosshair(field), same, Noise.of(0 * one), guide, guide, None)
    rng = np.random.default_rng(0)
    place = jnp.asarray(rng.uniform(8, 24, (20, 2)), jnp.float32)
    # A multiple of the spacing of the sweep, so that one of its disparities is the right one.
    labels = jnp.asarray(0.4 + rng.integers(-3, 4, 20) / 16, jnp.float32)
    towards = jnp.tile(jnp.asarray([1.0, 0.0], jnp.float32), (20, 1))
    evidence = Evidence(views, None, None)
    params = cast(authors.AuthorsLabels(), jnp.float32)
    found = authors._swept(place, labels, towards, evidence, params)
    assert bool(found.known.mean() > 0.8)
    np.testing.assert_allclose(np.asarray(found.disparity)[np.asarray(found.known)], 0.4, atol=1e-5)


@pytest.mark.slow
def test_the_chain_is_about_as_good_as_the_program():
    field = load_light_field(shared_data("hci", "cotton"))
    assert field.truth is not None
    blind = field.without_truth()
    found = authors.authors_model(blind)(blind, key=jax.random.key(0))
    scores = depth_scores(found.disparity, field.truth.disparity)
    columns = scores.mse, scores.q25, scores.bad_01, scores.bad_03, scores.bad_07
    # The program itself has .693, .585, 59.4, 20.2 and 4.70 on this scene, full frame.
    assert (np.asarray(columns) < 1.1 * np.asarray([0.47, 0.55, 56.4, 17.6, 5.94])).all()
