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


def _slant(grid=(3, 3), shape=(40, 48)):
    """Views of a textured plane whose disparity is 1 px per view step."""
    texture = np.random.default_rng(0).uniform(0.2, 0.8, (shape[0] + 8, shape[1] + 8, 3))
    rows = [
        [texture[v : v + shape[0], u : u + shape[1]] for u in range(grid[1])]
        for v in range(grid[0])
    ]
    return np.asarray(rows)


def _corner(shape, size):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return (shape[0] - 1 - y) + x < size


def test_a_fixed_corner_is_unlit_and_little_around_it():
    views, corner = _slant(), _corner((40, 48), 12)
    views[:, :, corner] = 0
    found = np.asarray(lit(crosshair(LightField(jnp.asarray(views, jnp.float32))), Brightness()))
    assert found.dtype == np.float32
    assert set(np.unique(found)) == {0.0, 1.0}
    assert (found[corner] == 0).all()
    y, x = np.nonzero(found == 0)
    assert ((39 - y) + x).max() <= 12 + 6
    arms = crosshair(LightField(jnp.asarray(views, jnp.float32)))
    assert (np.asarray(lit(arms, Brightness(dark_reach=0)) == 0) == corner).all()
    assert bool((lit(arms, Brightness(black=jnp.asarray(0.0))) == 1).all())


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
    assert bool((lit(crosshair(LightField(jnp.asarray(views))), Brightness()) == 1).all())


def test_a_single_row():
    views = _slant((1, 5))
    views[:, :, _corner((40, 48), 12)] = 0
    found = np.asarray(lit(crosshair(LightField(jnp.asarray(views))), Brightness()))
    assert (found[_corner((40, 48), 12)] == 0).all()
    assert found.mean() > 0.9


@pytest.mark.slow
def test_a_dark_corner_goes_on_with_what_is_beside_it():
    views, corner = _slant(), _corner((40, 48), 14)
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
