"""The posterior over hypotheses: closed forms without texture, and with a texture that repeats."""

import jax.numpy as jnp
import numpy as np
from photometry.planes import plane_arms

from mvedge_jax._crosshair import Crosshair, crosshair
from mvedge_jax.lightfield import LightField
from mvedge_jax.photometry.matching import Matching, hypotheses


def test_without_texture_all_hypotheses_are_as_likely():
    arms = crosshair(LightField(jnp.full((3, 3, 12, 14, 3), 0.4)))
    tried = jnp.linspace(-2, 1, 7)
    found = hypotheses(arms, jnp.zeros((3, 12, 14)), tried, Matching(), window=1)
    np.testing.assert_allclose(found.mean, -0.5, atol=1e-9)
    np.testing.assert_allclose(found.variance, np.var(tried), rtol=1e-9)
    np.testing.assert_allclose(
        found.variance_around(jnp.full((12, 14), tried[0])), np.mean((tried + 2) ** 2)
    )


def test_the_posterior_is_narrow_on_texture_and_wide_where_a_texture_repeats():
    across, down = plane_arms(0.5)
    tried = jnp.linspace(-1, 1, 41)
    lab = 100 * across.planes[across.centre]
    found = hypotheses(Crosshair(across, down), lab, tried, Matching(), window=2)
    inner = (slice(6, -6), slice(6, -6))
    assert float(jnp.median(found.variance_around(found.disparity)[inner])) < 0.05**2

    # Columns that repeat after 4 px: -3, 1 and 5 px per view step explain all views.
    columns = jnp.asarray([0.2, 0.5, 0.9, 0.4])[(jnp.arange(40)) % 4]
    views = jnp.stack([jnp.roll(columns, s) for s in (1, 0, -1)])
    views = jnp.broadcast_to(views[None, :, None, :, None], (3, 3, 12, 40, 3))
    arms = crosshair(LightField(views))
    lab = 100 * jnp.moveaxis(views[1, 1], -1, 0)
    found = hypotheses(arms, lab, jnp.arange(-5.0, 7.0), Matching(), window=2)
    np.testing.assert_allclose(found.mean[:, 8:-8], 1, atol=0.1)
    np.testing.assert_allclose(found.variance[:, 8:-8], 32 / 3, rtol=0.1)
