"""What the lens leaves dark is told from what is merely black."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax import EdgeDepth, LightField
from mvedge_jax._crosshair import crosshair
from mvedge_jax.photometry.brightness import Brightness
from mvedge_jax.photometry.brightness._unlit import lit


def _slant(grid=(3, 3)):
    """Views of a textured plane whose disparity is 1 px per view step."""
    texture = np.random.default_rng(0).uniform(0.2, 0.8, (48, 56, 3))
    rows, columns = map(range, grid)
    return np.asarray([[texture[v : v + 40, u : u + 48] for u in columns] for v in rows])


# How far a pixel is from the lower left corner.
AWAY = np.add.outer(np.arange(39, -1, -1), np.arange(48))


def _lit(views, dtype: type = np.float64, **numbers):
    arms = crosshair(LightField(jnp.asarray(views, dtype)))
    return np.asarray(lit(arms, Brightness(**numbers)))


@pytest.mark.parametrize("grid", [(3, 3), (1, 5)])
def test_a_fixed_corner_is_unlit_and_little_around_it(grid):
    views, corner = _slant(grid), AWAY < 12
    views[:, :, corner] = 0
    found = _lit(views, np.float32)
    assert found.dtype == np.float32
    assert set(np.unique(found)) == {0.0, 1.0}
    assert (found[corner] == 0).all()
    assert AWAY[found == 0].max() <= 12 + 6
    assert ((_lit(views, dark_reach=0) == 0) == corner).all()
    assert (_lit(views, black=jnp.asarray(0.0)) == 1).all()


@pytest.mark.parametrize(
    "blacken",
    [
        lambda views: None,
        # Black things within the picture, and one that moves from view to view.
        lambda views: views.__setitem__(np.s_[:, :, 10:20, 10:20], 0),
        lambda views: [views.__setitem__(np.s_[:, u, :5, 12 * u : 12 * u + 12], 0) for u in (0, 2)],
        lambda views: views.__setitem__(np.s_[1, 1, :5, :12], 0),
        # Dark is not black.
        lambda views: views.__setitem__(np.s_[:, :, :5, :12], 0.01),
    ],
    ids=["nothing", "inside", "moving", "one view", "dark"],
)
def test_all_else_is_lit(blacken):
    views = _slant()
    blacken(views)
    assert (_lit(views) == 1).all()


@pytest.mark.slow
def test_a_dark_corner_goes_on_with_what_is_beside_it():
    views, corner = _slant(), AWAY < 14
    views[:, :, corner] = 0
    field = LightField(jnp.asarray(views), disparity_range=(-1.0, 3.0))
    model = EdgeDepth.for_light_field(field)
    found = model(field)
    assert float(jnp.abs(found.disparity - 1).max()) < 0.1
    assert bool(jnp.isfinite(found.error).all())
    # What is behind it is known less, the farther from what was measured.
    assert float(found.error[corner].min()) > 2 * float(jnp.median(found.error[~corner]))

    def total(views):
        seen = eqx.tree_at(lambda f: f.views, field, views)
        return jnp.sum(model(seen).disparity)

    assert bool(jnp.isfinite(jax.jit(jax.grad(total))(field.views)).all())
