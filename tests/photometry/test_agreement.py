"""How well photographs agree on a hypothesis: correlations by hand, soft minima between bounds."""

import jax.numpy as jnp
import numpy as np

from mvedge_jax.photometry.matching import Agreement
from mvedge_jax.photometry.matching._agreement import Window


def test_a_correlation_is_that_of_the_windows_and_knows_no_gain():
    rng = np.random.default_rng(0)
    colors, other = jnp.asarray(rng.uniform(size=(2, 3, 8, 9)))
    weights = jnp.full((9, 8, 9), 1 / 9)
    window = Window.of(colors, weights, jnp.asarray(1e-9))
    found = np.asarray(window.unlike(other))[4, 4]
    both = np.stack([np.asarray(a)[:, 3:6, 3:6].reshape(3, 9) for a in (colors, other)])
    both = both - both.mean(-1, keepdims=True)
    expected = (both[0] * both[1]).sum() / np.sqrt((both**2).sum((1, 2)).prod())
    np.testing.assert_allclose(found, 0.5 * (1 - expected), rtol=1e-6)
    np.testing.assert_allclose(window.unlike(0.7 * colors + 0.2), 0, atol=1e-6)
    plain = window.unlike(jnp.full_like(colors, 0.5))
    np.testing.assert_allclose(plain, 0.5, atol=1e-6)


def test_photographs_that_do_not_show_a_pixel_count_little():
    costs = jnp.asarray([0.1, 0.12, 0.9, 1.0])[:, None, None]
    found = float(Agreement().pooled(costs)[0, 0])
    assert 0.1 < found < 0.2
    np.testing.assert_allclose(
        Agreement(temperature=jnp.asarray(100.0)).pooled(costs), costs.mean(), rtol=2e-3
    )
    np.testing.assert_allclose(
        Agreement(temperature=jnp.asarray(1e-5)).pooled(costs), 0.1, rtol=1e-3
    )
