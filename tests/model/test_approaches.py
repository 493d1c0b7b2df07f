"""What corrects a first map: views that agree, bending that is polished, steps that relocate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient, count_traces

from mvedge_jax.losses import Views
from mvedge_jax.model.approaches import (
    Bending,
    StepRelocation,
    ViewAgreement,
    polish,
    relocate_steps,
)
from mvedge_jax.model.approaches._evidence import agreed_correction
from mvedge_jax.model.approaches._polish import bending

SHAPE = (20, 22)


def scene(disparity=0.3, *, noise=0.0, reach=2, dtype: type = np.float32):
    """Views of a fronto-parallel texture of sinusoids."""
    rng = np.random.default_rng(0)
    waves = rng.uniform(-1.2, 1.2, (12, 2))
    phases = rng.uniform(0, 2 * np.pi, (3, 12))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)

    def image(step):
        # The point (x, y) of the centre is at (x + s d) in the view, so the view shows x - s d.
        at_x, at_y = x - step[0] * disparity, y - step[1] * disparity
        arguments = waves[:, 0, None, None] * at_x + waves[:, 1, None, None] * at_y
        planes = 0.5 + 0.03 * np.sin(arguments[None] + phases[:, :, None, None]).sum(1)
        return planes + noise * rng.normal(size=planes.shape)

    places = np.arange(-reach, reach + 1)
    steps = [(float(i), float(j)) for i in places for j in places if (i, j) != (0, 0)]
    others = np.stack([image(s) for s in steps])
    return Views(
        jnp.asarray(image((0.0, 0.0)), dtype),
        jnp.asarray(others, dtype),
        jnp.asarray(steps, dtype),
        jnp.ones(len(steps), bool),
    )


def flat(value):
    return jnp.full(SHAPE, value, jnp.float32)


def inner(image):
    return np.asarray(image)[5:-5, 5:-5]


def agreed(views, disparity, params=None):
    params = ViewAgreement() if params is None else params
    return agreed_correction(views, disparity, params, radius=2)


def test_halves_of_the_views_confirm_an_error():
    found = agreed(scene(), flat(0.33))
    np.testing.assert_allclose(inner(found.change), -0.03, atol=0.004)
    assert inner(found.share).min() > 0.9


def test_a_map_that_is_right_stays_and_so_does_one_that_no_view_speaks_of():
    np.testing.assert_allclose(inner(agreed(scene(), flat(0.3)).change), 0, atol=0.004)
    blind = eqx.tree_at(lambda v: v.available, scene(), jnp.zeros(24, bool))
    np.testing.assert_allclose(agreed(blind, flat(0.33)).change, 0, atol=1e-6)


def test_halves_do_not_confirm_noise():
    alone = ViewAgreement(region=jnp.asarray(1e-3))
    change, own = (agreed(scene(noise=0.02), flat(0.3), p).change for p in (None, alone))
    assert np.square(inner(change)).mean() < np.square(inner(own)).mean()


def test_one_trace_serves_all_parameters_and_x64_changes_little():
    single, double = scene(), scene(dtype=np.float64)
    traced, traces = count_traces(lambda v, d, p: agreed(v, d, p).change)
    first = traced(single, flat(0.31), ViewAgreement())
    traced(single, flat(0.31), ViewAgreement(region=jnp.asarray(2.0)))
    assert traces() == 1
    assert first.dtype == jnp.float32
    exact = agreed(double, flat(0.31).astype(jnp.float64)).change
    np.testing.assert_allclose(first, exact, atol=2e-4)


def test_nothing_is_measured_beside_depth_steps():
    """Windows reach across them, and so do neighbours that share their measurements."""
    step = jnp.where(jnp.arange(SHAPE[1]) > SHAPE[1] // 2, 0.8, 0.3)
    found = agreed(scene(), jnp.broadcast_to(step, SHAPE).astype(jnp.float32))
    beside = np.abs(np.arange(SHAPE[1]) - (SHAPE[1] // 2 + 0.5)) < 5
    np.testing.assert_array_equal(np.asarray(found.weight)[:, beside], 0)
    assert np.all(np.asarray(found.weight)[:, 2:5] > 0)


def surfaces(shape=(24, 30)):
    """Two slanted planes with a step between them."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    return jnp.asarray(np.where(x > 14, 1 + 0.01 * y, 0.008 * x))


def test_planes_and_steps_do_not_bend():
    truth = surfaces()
    assert float(bending(truth, truth, Bending())) < 1e-9
    crossed = bending(truth, jnp.zeros_like(truth), Bending())
    assert float(crossed) > 1000
    # A steep slant is no step: its noise counts.
    slant = 0.06 * jnp.arange(20.0)[None] + jnp.zeros((9, 1))
    noisy = slant + 0.004 * jax.random.normal(jax.random.key(3), slant.shape)
    assert float(bending(noisy, noisy, Bending())) > 100


def test_noise_goes_and_the_step_stays():
    truth = surfaces()
    noisy = truth + 0.004 * jax.random.normal(jax.random.key(0), truth.shape)
    found = polish(noisy, Bending())
    before, after = (float(jnp.sqrt(jnp.mean((m - truth) ** 2))) for m in (noisy, found))
    assert after < 0.5 * before
    np.testing.assert_array_equal(found[:, 14:16], noisy[:, 14:16])
    np.testing.assert_allclose(polish(truth, Bending()), truth, atol=1e-3)


def test_gradient_of_bending_and_one_trace():
    guide = surfaces((9, 20))
    rough = guide + 0.003 * jax.random.normal(jax.random.key(1), guide.shape)
    check_gradient(
        lambda d: bending(d, guide, Bending()), rough, rtol=1e-6, step=1e-7,
        directions=2, key=jax.random.key(2),
    )  # fmt: skip
    traced, traces = count_traces(lambda d, p: polish(d, p, iterations=3))
    single = traced(rough.astype(jnp.float32), Bending())
    assert single.dtype == jnp.float32
    traced(guide.astype(jnp.float32), Bending(weight=jnp.asarray(1.0)))
    assert traces() == 1


def test_in_derivatives_the_change_is_a_constant():
    rough = surfaces((7, 20)).at[2, 4].add(0.002)

    def loss(disparity, params):
        return jnp.sum(jnp.sin(40 * polish(disparity, params)))

    of_map, of_params = jax.jit(jax.grad(loss, (0, 1)))(rough, Bending())
    np.testing.assert_allclose(of_map, 40 * jnp.cos(40 * polish(rough, Bending())), rtol=1e-9)
    assert all(float(leaf) == 0 for leaf in jax.tree.leaves(of_params))
    _, forward = jax.jvp(polish, (rough, Bending()), (rough, Bending()))
    np.testing.assert_array_equal(forward, rough)


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
