"""Depth steps that move to image edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces

from experiments.peers.relocation import StepRelocation, relocate_steps


def edge_beside_step(off, *, down=False, size=24):
    """A map whose step lies `off` pixels beside the edge of its image, and the true map."""
    columns = jnp.arange(size)[None] + jnp.zeros((size, 1), int)
    image = jnp.where(columns >= 11, jnp.array([0.7, 0.5, 0.2])[:, None, None], 0.3)
    maps = [jnp.where(columns >= edge, 0.8, -0.4) for edge in (11 + off, 11)]
    if down:
        image, maps = jnp.swapaxes(image, 1, 2), [one.T for one in maps]
    return image, *maps


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("off", [-1, 0, 1])
def test_a_step_moves_to_the_image_edge(off, down):
    image, disparity, truth = edge_beside_step(off, down=down)
    np.testing.assert_allclose(
        relocate_steps(disparity, image, StepRelocation()), truth, rtol=0, atol=0.02
    )


@pytest.mark.parametrize("reach", [1, 2, 3])
def test_it_reaches_as_far_as_it_says(reach):
    image, disparity, truth = edge_beside_step(reach)
    found = relocate_steps(disparity, image, StepRelocation(), reach=reach)
    np.testing.assert_allclose(found, truth, rtol=0, atol=0.02)
    image, disparity, truth = edge_beside_step(reach + 1)
    found = relocate_steps(disparity, image, StepRelocation(), reach=reach)
    assert jnp.abs(found - truth).max() > 0.1


@pytest.mark.parametrize("kind", ["slanted", "steps alone"])
def test_maps_without_a_step_in_doubt_stay(kind):
    rows, columns = jnp.mgrid[:24, :24]
    steps = jnp.where((rows + columns) % 2 == 0, 1.0, 0.0)
    disparity, atol = {
        "slanted": ((2 * rows - 3 * columns) / 20, 1e-4),
        "steps alone": (steps, 0.01),
    }[kind]
    found = relocate_steps(disparity, edge_beside_step(0)[0], StepRelocation())
    np.testing.assert_allclose(found, disparity, rtol=0, atol=atol)


def test_gradient_against_differences_and_one_trace():
    image, disparity, _ = edge_beside_step(1)
    weights = jax.random.normal(jax.random.key(0), disparity.shape)
    move = (
        jax.random.normal(jax.random.key(1), disparity.shape),
        0.1 * jax.random.normal(jax.random.key(2), image.shape),
    )

    def total(disparity, image, params):
        return jnp.sum(weights * relocate_steps(disparity, image, params))

    traced, traces = count_traces(total)
    params = StepRelocation(step=jnp.asarray(0.2))
    slopes = jax.grad(total, (0, 1))(disparity, image, params)
    slope = sum(jnp.vdot(a, b) for a, b in zip(slopes, move, strict=True))
    moved = [(disparity + s * move[0], image + s * move[1]) for s in (1e-5, -1e-5)]
    ahead, behind = (traced(*one, params) for one in moved)
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-5, rtol=1e-4)
    traced(*moved[0], StepRelocation(step=jnp.asarray(0.3)))
    assert traces() == 1


def test_errors():
    image, disparity, _ = edge_beside_step(1)
    # A type error where shapes are checked at run time, as in these tests.
    with pytest.raises((ValueError, TypeError), match="image"):
        relocate_steps(disparity, image[:, :, :-1], StepRelocation())
    with pytest.raises(ValueError, match="`reach` must be at least 1 pixel, got 0"):
        relocate_steps(disparity, image, StepRelocation(), reach=0)
