"""The chain on views that tell nothing or hardly anything, and of the least sizes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from mvedge_jax import EdgeDepth, LightField

RANGE = (-1.0, 2.0)
FLAT = {"black": (0.0, 0.0, 0.0), "constant": (0.5, 0.4, 0.6), "saturated": (1.0, 1.0, 1.0)}


def _same(image, grid=(3, 3), dtype=np.float32):
    views = np.broadcast_to(image, (*grid, *image.shape))
    return LightField(jnp.asarray(views, dtype), disparity_range=RANGE)


def _flat(color, shape=(16, 16), grid=(3, 3)):
    return _same(np.full((*shape, 3), color), grid)


def _two_colors(shape=(16, 16), grid=(3, 3)):
    image = np.full((*shape, 3), (0.2, 0.2, 0.2))
    image[:, shape[1] // 2 :] = (0.9, 0.6, 0.1)
    return _same(image, grid)


def _model(field):
    choices = {"refine.sharpen.levels": 4, "refine.sharpen.radius": 2}
    return EdgeDepth.for_light_field(field, choices=choices)


def _is_sound(found):
    """Numbers everywhere, or no claim to have converged."""
    finite = bool(jnp.isfinite(found.disparity).all())
    assert finite or not bool(found.stats.converged)
    assert finite
    assert bool((found.error > 0).all())


@pytest.mark.parametrize("name", FLAT)
def test_without_evidence_the_error_is_as_wide_as_the_range(name):
    field = _flat(FLAT[name])
    found = _model(field)(field)
    _is_sound(found)
    assert float(found.error.min()) >= RANGE[1] - RANGE[0]
    said = " ".join(found.problems())
    assert "no edge was found" in said
    assert "half of the pixels have a standard error above" in said


def test_two_colors_and_noise_alone():
    field = _two_colors()
    _is_sound(_model(field)(field))
    noise = np.random.default_rng(0).uniform(size=field.views.shape)
    noisy = eqx.tree_at(lambda f: f.views, field, jnp.asarray(noise, jnp.float32))
    found = _model(field)(noisy)
    _is_sound(found)
    assert found.problems()


@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda *a: _flat(FLAT["constant"], *a), _two_colors])
@pytest.mark.parametrize(
    ("shape", "grid"),
    [((1, 1), (3, 3)), ((1, 40), (3, 3)), ((40, 1), (3, 3)), ((2, 3), (1, 3)), ((24, 24), (3, 1))],
)
def test_the_least_sizes(make, shape, grid):
    field = make(shape, grid)
    _is_sound(_model(field)(field))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FLAT, "two colors"])
def test_gradients_are_finite_there(name):
    field = _two_colors() if name == "two colors" else _flat(FLAT[name])

    @jax.jit
    def gradient(model, views):
        def total(model, views):
            found = model(eqx.tree_at(lambda f: f.views, field, views))
            return found.disparity.sum() + found.error.sum()

        return jax.grad(total, argnums=(0, 1))(model, views)

    for leaf in jax.tree.leaves(gradient(_model(field), field.views)):
        assert bool(jnp.isfinite(leaf).all())


def _plane(seed):
    """A plane with texture at disparity 0.5, 3x3 views."""
    rng = np.random.default_rng(seed)
    texture = ndimage.gaussian_filter(rng.uniform(size=(36, 36, 3)), (1, 1, 0)) * 2 - 0.5
    y, x = np.mgrid[:16, :16].astype(float) + 10
    views = np.zeros((3, 3, 16, 16, 3))
    for v, u, c in np.ndindex(3, 3, 3):
        place = [y - (1 - v) * 0.5, x - (1 - u) * 0.5]
        views[v, u, ..., c] = ndimage.map_coordinates(texture[..., c], place, order=3)
    return np.clip(views, 0, 1)


@pytest.mark.slow
def test_vmap_over_light_fields_and_over_every_number_is_the_loop():
    field = LightField(jnp.asarray(_plane(0)), disparity_range=RANGE)
    model = _model(field)

    def one(model, views):
        found = model(eqx.tree_at(lambda f: f.views, field, views))
        return found.disparity, found.error

    single = jax.jit(one)
    # Textured, constant, of two colors: each stops on its own.
    every = [
        _plane(0),
        _plane(1),
        np.full(field.views.shape, 0.5),
        np.asarray(_two_colors().views),
    ]
    views = jnp.stack([jnp.asarray(v, field.views.dtype) for v in every])
    leaves, tree = jax.tree.flatten(model)
    moved = [
        [leaf * 1.2 if i == k else leaf for i, leaf in enumerate(leaves)]
        for k in range(len(leaves))
    ]
    stacked = tree.unflatten([jnp.stack(rows) for rows in zip(*moved, strict=True)])
    cases = [
        (jax.vmap(one, (None, 0)), (model, views), [(model, v) for v in views]),
        (
            jax.vmap(one, (0, None)),
            (stacked, field.views),
            [(tree.unflatten(row), field.views) for row in moved],
        ),
    ]
    for mapped, together, alone in cases:
        both = jax.jit(mapped)(*together)
        for index, arguments in enumerate(alone):
            for many, wanted in zip(both, single(*arguments), strict=True):
                np.testing.assert_allclose(many[index], wanted, rtol=0, atol=1e-7)
