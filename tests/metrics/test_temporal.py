"""Change between frames: what counts as unchanged, by noise, and what is measured there."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.metrics import temporal_consistency

SHAPE = (24, 30)


def _views(noise, rng):
    """Two noisy views of one texture; the left half of the second shows another one."""
    texture, other = (rng.uniform(size=(*SHAPE, 3)) for _ in range(2))
    moved = np.where(np.arange(SHAPE[1])[None, :, None] < 15, other, texture)
    return [
        jnp.asarray(view + noise * rng.normal(size=view.shape), jnp.float32)
        for view in (texture, moved)
    ]


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_only_what_looks_the_same_is_compared(noise):
    rng = np.random.default_rng(1)
    before, view = _views(noise, rng)
    maps = (
        jnp.zeros(SHAPE),
        jnp.where(jnp.arange(SHAPE[1]) < 15, 5.0, 0.125)[None] * jnp.ones(SHAPE),
    )
    found = temporal_consistency(maps[1], maps[0], view, before, noise=noise)
    # Two columns beside the texture that changed have some of it in their windows.
    assert found.unchanged == pytest.approx(13 / 30, abs=0.02)
    assert found.change == pytest.approx(0.125)
    assert found.changed_07 == 100
    # Without the noise being told, nothing looks the same.
    if noise:
        assert temporal_consistency(maps[1], maps[0], view, before).unchanged == 0


def test_holes_are_left_out_and_nothing_is_nan():
    view = jnp.full((*SHAPE, 3), 0.5)
    holes = jnp.zeros(SHAPE).at[:, :10].set(jnp.nan)
    found = temporal_consistency(holes, jnp.full(SHAPE, 0.05), view, view)
    assert found.unchanged == pytest.approx(2 / 3)
    assert found.change == pytest.approx(0.05)
    assert found.changed_07 == 0
    assert jnp.isnan(temporal_consistency(holes * jnp.nan, holes, view, view).change)


def test_has_the_derivative_of_the_mean_change():
    view = jnp.full((*SHAPE, 3), 0.5)
    disparity = jnp.asarray(np.random.default_rng(2).normal(size=SHAPE))
    zero = jnp.zeros(SHAPE).at[0, 0].set(jnp.nan)
    slope = jax.grad(lambda d: temporal_consistency(d, zero, view, view).change)(disparity)
    expected = jnp.sign(disparity).at[0, 0].set(0) / (disparity.size - 1)
    np.testing.assert_allclose(slope, expected, rtol=1e-5)


def test_shapes_that_do_not_fit_are_named():
    view, flat = jnp.zeros((*SHAPE, 3)), jnp.zeros(SHAPE)
    change = inspect.unwrap(temporal_consistency)  # without the type checker
    with pytest.raises(ValueError, match=r"`disparity` and `before`.*\(24, 30\) and \(5, 5\)"):
        change(flat, jnp.zeros((5, 5)), view, view)
    with pytest.raises(ValueError, match="`view` and `view_before` must be images"):
        change(flat, flat, view, view[:-1])
