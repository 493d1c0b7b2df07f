import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient

from mvedge_jax.epi import bank_radius, exponential_disparities, prewitt_bank
from mvedge_jax.epi._bank import line_taps
from mvedge_jax.epi._response import bank_response

_DISPARITY = np.array([-1.7, -0.6, -0.25, 0.0, 0.33, 1.0, 2.0])


def _bank(views=5):
    return prewitt_bank(jnp.asarray(_DISPARITY), views, bank_radius(2.0, views))


def _arm(views=5, shape=(3, 21), channels=2, seed=0):
    return jax.random.normal(jax.random.key(seed), (views, *shape, channels), jnp.float64)


def _brute_force(arm, bank):
    """Plain loops over the 2-D filters, edge values beyond the border."""
    views, height, width, channels = arm.shape
    taps, radius = np.asarray(bank.taps), bank.radius
    out = np.zeros((height, width, channels, len(taps)))
    for k, y, x in np.ndindex(len(taps), height, width):
        for u in range(views):
            for w in range(2 * radius + 1):
                at = min(max(x + w - radius, 0), width - 1)
                out[y, x, :, k] += taps[k, u, w] * arm[u, y, at]
    return out


def _sheared(arm, disparity):
    """Views shifted by their steps, averaged, and differenced: no taps at all."""
    steps, x = arm.shape[0] // 2 - np.arange(arm.shape[0]), np.arange(arm.shape[2])

    def line(values, at):
        return np.interp(at, x, values)

    def mean(d, offset):
        moved = [
            np.apply_along_axis(line, 1, view, x + step * d + offset)
            for view, step in zip(arm, steps, strict=True)
        ]
        return np.mean(moved, 0)

    return np.stack([mean(d, 1) - mean(d, -1) for d in disparity], -1)


def test_explicit_taps_sheared_sum_and_brute_force_agree():
    arm, bank = _arm(), _bank()
    response = bank_response(arm, bank)
    np.testing.assert_allclose(response, _sheared(np.asarray(arm), _DISPARITY), atol=1e-13)
    np.testing.assert_allclose(response, _brute_force(np.asarray(arm), bank), atol=1e-13)


def test_more_rows_than_a_block_give_the_same_rows():
    arm, bank = _arm(shape=(37, 12), channels=1), _bank()
    whole = bank_response(arm, bank)
    np.testing.assert_allclose(whole[33:36], bank_response(arm[:, 33:36], bank), atol=1e-13)


def test_a_flat_image_has_no_edges_at_all():
    """Not at the borders either, where zero padding would invent one."""
    assert float(jnp.abs(bank_response(jnp.full((5, 2, 11, 1), 0.7), _bank())).max()) < 1e-12


@pytest.mark.parametrize("slope", [-1.7, -0.25, 0.33, 2.0])
def test_a_unit_step_answers_with_one_for_every_slope(slope):
    steps = 2 - np.arange(5)
    x = np.arange(41)
    epi = np.clip(x[None] - (20 + steps * slope)[:, None] + 0.5, 0, 1)
    response = np.asarray(bank_response(jnp.asarray(epi)[:, None, :, None], _bank()))[0, 20, 0]
    own = response[slope == _DISPARITY][0]
    # A slope off by less than half a pixel at the ends still has the step between its lines.
    assert own == pytest.approx(1, abs=0.06)
    assert own >= response.max() - 0.03
    assert own > response[np.abs(_DISPARITY - slope) > 0.55].max() + 0.02


def test_taps_sum_to_zero_and_lines_to_one():
    taps = line_taps(jnp.asarray(_DISPARITY), 5, bank_radius(2.0, 5))
    np.testing.assert_allclose(taps.sum((1, 2)), 1, atol=1e-14)
    np.testing.assert_allclose(_bank().taps.sum((1, 2)), 0, atol=1e-14)


def test_response_is_differentiable_in_views_and_taps():
    weight = jax.random.normal(jax.random.key(3), (3, 21, 2, 7), jnp.float64)

    def loss(tree):
        arm, bank = tree
        return (weight * jnp.sin(bank_response(arm, bank))).sum()

    check_gradient(loss, (_arm(), _bank()), rtol=1e-7, key=jax.random.key(1))


def test_exponential_spacing_is_that_of_the_reference_notes():
    values = exponential_disparities(60, 2.0)
    assert values.shape == (59,)
    np.testing.assert_allclose(values, -values[::-1], atol=1e-15)
    np.testing.assert_allclose(values[-3:], [1.789, 1.893, 2.0], atol=1e-3)
    np.testing.assert_allclose(np.diff(values)[29], 0.0408, atol=2e-3)


def test_mistakes_are_named():
    with pytest.raises(ValueError, match=r"`bank` is for 5 views, `arm` has 3"):
        bank_response(jnp.zeros((3, 2, 8, 1)), _bank())
    with pytest.raises(ValueError, match=r"`count` must be at least 4, got 3"):
        exponential_disparities(3, 2.0)
    with pytest.raises(ValueError, match=r"`reach` must be positive"):
        exponential_disparities(60, 0.0)


def test_taps_follow_the_steps_of_the_views():
    disparity, radius = jnp.asarray(_DISPARITY), bank_radius(2.0, 7)
    even = jnp.arange(2, -3, -1, dtype=disparity.dtype)
    regular = prewitt_bank(disparity, 5, radius).taps
    np.testing.assert_array_equal(prewitt_bank(disparity, 5, radius, steps=even).taps, regular)
    # Half the disparity over twice the steps is the same line.
    wide = prewitt_bank(disparity / 2, 5, radius, steps=2 * even).taps
    np.testing.assert_allclose(wide, regular, atol=1e-12)
    uneven = even.at[0].set(2.5).at[3].set(-1.3)
    taps = prewitt_bank(disparity, 5, radius, steps=uneven).taps
    jitted = jax.jit(lambda s: prewitt_bank(disparity, 5, radius, steps=s).taps)
    np.testing.assert_allclose(jitted(uneven), taps, atol=1e-15)
    # A line of disparity 2 is at 5 px in the first view: the average is ahead by 1 px, 6.
    assert int(jnp.argmax(taps[-1, 0])) - radius == 6


def test_the_gradient_in_the_steps():
    disparity = jnp.asarray([-0.63, 0.31, 1.17])
    shown = jax.random.normal(jax.random.key(1), (3, 5, 21))
    steps = jnp.asarray([2.1, 0.9, -1.2, -2.3])

    def loss(others):
        every = jnp.insert(others, 2, 0.0)
        return jnp.sum(shown * prewitt_bank(disparity, 5, 10, steps=every).taps)

    check_gradient(loss, steps, rtol=1e-6, step=1e-6, key=jax.random.key(2))
