"""Eq. 7.3 to 7.14 against integrals along a ray by SciPy, which share no code with `splatting`."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import integrate

from mvedge_jax.splatting import SplatRaster, SplatWidths, absorption, splat

SHAPE = (5, 6)
# ρ, σ_Z, σ_S, σ_λ, p of the thesis.
DENSITY, DEPTH, LABEL, WEIGHT, ORDER = 6.2, 1.0, 1.3, 0.71, 2
# Points along the ray, in σ_Z: far enough apart that each is alone where it absorbs.
APART = 20.0


def _points():
    rng = np.random.default_rng(4)
    xy = rng.uniform(0, [SHAPE[1] - 1, SHAPE[0] - 1], (4, 2))
    return xy, rng.normal(size=4), rng.uniform(0.3, 2, 4)


def _squares(xy):
    """Squared distance of every point from every pixel, `[n, y x]`."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return ((x.ravel() - xy[:, :1]) ** 2) + ((y.ravel() - xy[:, 1:]) ** 2)


def _rays(xy, label):
    """Optical depth and label (7.12) of every pixel's ray, in front of each point and at the end.

    Points lie along the ray in the order that they are given.
    """
    gaussian = np.exp(-_squares(xy) / (2 * LABEL**2))
    places = APART * (0.5 + np.arange(len(xy)))

    def slope(s, state):
        depth = state[: gaussian.shape[1]]
        along = np.exp(-((s - places) ** 2) / (2 * DEPTH**2))[:, None]
        density = DENSITY * gaussian * along
        shown = np.exp(-depth) * (label[:, None] * density).sum(0)
        return np.concatenate([density.sum(0), shown])

    ends = APART * np.arange(len(xy) + 1)
    start = np.zeros(2 * gaussian.shape[1])
    found = integrate.solve_ivp(
        slope, (0, ends[-1]), start, t_eval=ends, max_step=0.2, rtol=1e-9, atol=1e-12
    )
    optical, shown = np.split(found.y.T, 2, axis=1)
    return optical, shown[-1]


@pytest.mark.parametrize("nearest", ["largest", "smallest"])
def test_maps_are_integrals_along_rays(nearest):
    xy, label, weight = _points()
    order = np.argsort(-label if nearest == "largest" else label)
    optical, shown = _rays(xy[order], label[order])
    raster = SplatRaster(radius=14, nearest=nearest, order=ORDER)
    points = (jnp.asarray(xy), jnp.asarray(label), jnp.asarray(weight), jnp.ones(4, bool))
    widths = SplatWidths(*(jnp.asarray(w) for w in (LABEL, WEIGHT, DENSITY, DEPTH)))
    found = splat(*points, widths, SHAPE, raster)
    assert_allclose(np.ravel(found.label_sum), shown, atol=1e-7)
    assert_allclose(np.ravel(found.transmittance), np.exp(-optical[-1]), atol=1e-8)
    # (7.5) as corrected: the weight of a point (7.6) times what reaches the point.
    flat = np.exp(-((_squares(xy) / (2 * WEIGHT**2)) ** ORDER)) * weight[:, None]
    seen = (np.exp(-optical[:-1]) * flat[order]).sum(0)
    assert_allclose(np.ravel(found.weight), seen, atol=1e-8)


def test_the_samples_of_a_point_are_those_of_the_thesis():
    mean, samples = 5 * DEPTH, np.linspace(2 * DEPTH, 8 * DEPTH, 8)

    def along(z):
        return np.exp(-((z - mean) ** 2) / (2 * DEPTH**2))

    through_center = DENSITY * DEPTH * np.sqrt(2 * np.pi)
    for gaussian in (1.0, 0.7, 0.2, 0.01):

        def passed(end, gaussian=gaussian):
            """(7.8), which (7.9) solves: what one point lets through from 0 to `end`."""
            return np.exp(-DENSITY * gaussian * integrate.quad(along, 0, end, epsabs=1e-12)[0])

        # (7.14) as corrected, times the Gaussian of (7.4).
        step = samples[1] - samples[0]
        alpha = DENSITY * step * sum(passed(s) * along(s) for s in samples)
        thickness = jnp.asarray(through_center * gaussian)
        absorbed, _, left, constant = absorption(thickness, "quadrature")
        assert float(absorbed) == pytest.approx(alpha * gaussian, abs=1e-10)
        assert float(left) == pytest.approx(passed(samples[-1]), abs=1e-10)
        # (7.10): the constant of the exponent.
        assert -constant * through_center * gaussian == pytest.approx(np.log(passed(samples[-1])))
        # The integral that the samples stand for, all of the point in front of its end.
        exact = 1 - np.exp(-DENSITY * gaussian * integrate.quad(along, -30, 40, points=[mean])[0])
        assert float(absorption(thickness, "closed")[0]) == pytest.approx(exact, abs=1e-10)
