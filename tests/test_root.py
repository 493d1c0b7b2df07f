"""The square root that has a slope at 0."""

import jax
import jax.numpy as jnp
import numpy as np

from mvedge_jax._root import safe_sqrt


def test_it_is_a_square_root_whose_slope_at_0_is_0():
    values = jnp.asarray([0.0, 1e-30, 0.25, 9.0])
    np.testing.assert_array_equal(safe_sqrt(values), jnp.sqrt(values))
    slopes = jax.vmap(jax.grad(safe_sqrt))(values)
    assert slopes[0] == 0
    np.testing.assert_allclose(slopes[1:], 0.5 / jnp.sqrt(values[1:]), rtol=1e-12)
    assert float(jax.jvp(safe_sqrt, (0.0,), (1.0,))[1]) == 0
