"""Procedural noise: zero on the lattice, smooth, band-limited."""

import jax.numpy as jnp
import numpy as np

from mvedge_jax.datasets.synthetic._noise import fractal_noise, gradient_noise, hash_unit


def _line(x, seed=3):
    x = jnp.asarray(x)
    return np.asarray(
        gradient_noise((x, 0.4 + 0 * x, 0.7 + 0 * x), jnp.full(x.shape, seed, jnp.int32))
    )


def test_gradient_noise_vanishes_on_the_lattice_and_stays_bounded():
    grid = jnp.asarray(np.random.default_rng(0).integers(-50, 50, (3, 200)).astype(float))
    seed = jnp.zeros(200, jnp.int32)
    np.testing.assert_allclose(gradient_noise((grid[0], grid[1], grid[2]), seed), 0.0)
    values = _line(np.linspace(-300, 300, 20001))
    assert np.abs(values).max() < 1.6
    assert 0.15 < values.std() < 0.45
    assert abs(values.mean()) < 0.03


def test_gradient_noise_is_smooth_across_cells():
    """The second derivative is continuous at a lattice plane, also at negative coordinates."""
    for plane in (-7.0, 0.0, 4.0):
        h = 1e-3
        below = np.diff(_line(plane - h * np.arange(3)[::-1]), n=2) / h**2
        above = np.diff(_line(plane + h * np.arange(3)), n=2) / h**2
        np.testing.assert_allclose(below, above, atol=0.6)
    seeds = [_line(np.linspace(0, 50, 500), seed) for seed in (1, 2)]
    assert abs(np.corrcoef(seeds)[0, 1]) < 0.2


def test_fractal_noise_fades_below_the_footprint():
    """As seen by a pixel, little is left above the Nyquist frequency, and nothing if all is."""
    x = jnp.arange(4096.0) * 0.01  # a pixel every 0.01
    one = jnp.ones_like(x)
    seed = jnp.full(x.shape, 5, jnp.int32)
    position = (x, 0.3 * one, 0.1 * one)
    sampled = np.asarray(fractal_noise(position, 2 * one, 0.9 * one, 0.01 * one, seed))
    finer = tuple(jnp.repeat(p, 8) for p in position)
    finer = (jnp.arange(8 * 4096.0) * 0.01 / 8, finer[1], finer[2])
    dense = np.asarray(
        fractal_noise(finer, *(jnp.repeat(a, 8) for a in (2 * one, 0.9 * one, 0.01 * one, seed)))
    )
    power = np.abs(np.fft.rfft(dense * np.hanning(len(dense)))) ** 2
    nyquist = len(power) // 8
    assert power[nyquist:].sum() / power[1:].sum() < 0.01
    assert power[nyquist // 4 : nyquist].sum() / power[1:].sum() > 0.01  # but detail is there
    np.testing.assert_allclose(dense[::8], sampled, atol=1e-12)
    nothing = fractal_noise(position, 50 * one, 0.9 * one, 0.01 * one, seed)
    np.testing.assert_array_equal(nothing, 0.0)


def test_hash_is_uniform():
    i, j = (g.ravel() for g in jnp.meshgrid(jnp.arange(-60.0, 60.0), jnp.arange(-60.0, 60.0)))
    values = np.asarray(hash_unit(i, j, jnp.zeros(i.shape, jnp.int32), jnp.dtype("float64")))
    counts = np.histogram(values, 10, (0, 1))[0]
    assert abs(counts / len(values) - 0.1).max() < 0.012
    assert len(np.unique(values)) > 0.99 * len(values)
