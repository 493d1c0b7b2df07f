"""What a result says against itself."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax import LightField, Parameters, Sizes, edge_to_depth


@pytest.fixture(scope="module")
def result():
    """A textured plane at disparity 0, and what the chain makes of it."""
    light_field = _plane(0)
    sizes = Sizes.for_light_field(light_field)
    return light_field, sizes, edge_to_depth(light_field, Parameters(), sizes)


def _plane(disparity):
    image = np.random.default_rng(0).uniform(0.2, 0.8, (24, 24, 3))
    views = np.stack(
        [
            np.stack(
                [
                    np.roll(image, ((1 - v) * disparity, (1 - u) * disparity), (0, 1))
                    for u in range(3)
                ]
            )
            for v in range(3)
        ]
    )
    return LightField(jnp.asarray(views), disparity_range=(-1.0, 1.0))


def test_a_good_map_says_nothing(result):
    _, sizes, found = result
    assert found.problems() == ()
    assert found.check() is found
    np.testing.assert_allclose(found.stats.searched, (-1.0, 1.0), atol=1e-12)
    assert bool(found.stats.sound)
    assert sizes.edges.ends[0] < -1.0


def test_every_leaf_that_is_nan_gives_nan_under_jit(result):
    light_field, sizes, _ = result
    run = eqx.filter_jit(lambda p: edge_to_depth(light_field, p, sizes))
    leaves, tree = jax.tree.flatten(Parameters())
    for index in range(len(leaves)):
        for value in (jnp.nan, -1.0):
            changed = [jnp.full_like(x, value) if i == index else x for i, x in enumerate(leaves)]
            found = run(jax.tree.unflatten(tree, changed))
            assert np.isnan(found.disparity).all()
            assert np.isnan(found.error).all()
            assert not bool(found.stats.converged)
            assert not bool(found.stats.sound)
    with pytest.raises(RuntimeError, match="a parameter is NaN, infinite or negative"):
        found.check()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda r: (r.stats.converged, False), "a diffusion stopped before its tolerance"),
        (lambda r: (r.stats.edges.overflow, 7), "7 weak edges found no slot"),
        (lambda r: (r.disparity, np.nan), "576 of 576 disparities are NaN or infinite"),
        (lambda r: (r.error, np.inf), "no pixel was measured at all"),
        (lambda r: (r.disparity, -1.2), "100 % of the pixels lie beyond the lowest disparity"),
        (lambda r: (r.disparity, 1.2), "beyond the highest disparity that was tried, 1 px"),
    ],
)
def test_what_is_wrong_is_said(result, change, text):
    found = result[2]
    leaf, value = change(found)
    where = next(i for i, x in enumerate(jax.tree.leaves(found)) if x is leaf)
    changed = eqx.tree_at(lambda r: jax.tree.leaves(r)[where], found, jnp.full_like(leaf, value))
    assert any(text in sentence for sentence in changed.problems())
    with pytest.raises(RuntimeError, match="The depth is not to be trusted: "):
        changed.check()
