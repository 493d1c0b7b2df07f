"""Brightness of the views: known gains, exposures and vignettes are recovered and taken out."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_gradient
from photometry.scenes import changed, cross_gains, exposure_along, rough_exposure, textured

from mvedge_jax._crosshair import crosshair
from mvedge_jax.datasets import synthetic
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.photometry.brightness import Brightness, Exposure, GridViews, expose
from mvedge_jax.photometry.brightness._unlit import lit

SIZE = (96, 112)
FLAT = jnp.full(SIZE, 0.5, jnp.float32)
ONE, NONE = jnp.float32(1), np.ones((5, 5))
CROSS = np.add.outer(np.arange(5) == 2, np.arange(5) == 2)


def both(field, disparity=FLAT):
    """What is measured without a map, and along one."""
    scale = jnp.ones((), disparity.dtype)
    return rough_exposure(field), exposure_along(field, scale, disparity)


@pytest.fixture(scope="module")
def bright():
    return textured(low=0.2)


@pytest.mark.parametrize(
    ("gain", "sigma"), [(NONE, 0.0), (cross_gains(), 0.0), (cross_gains(), 0.05)]
)
def test_known_gains_are_recovered_and_no_vignettes_invented(bright, gain, sigma):
    field = changed(bright, gain=gain, noise=sigma)
    exposures = both(field)
    rough, along = (np.asarray(exposure.gain) for exposure in exposures)
    assert np.abs(rough / gain - 1)[CROSS].max() < 0.02
    assert np.abs(along / gain - 1)[CROSS].max() < (0.003 if sigma == 0 else 0.01)
    assert (along[~CROSS] == 1).all()
    # To the digit: gains change nothing of the views' vignettes, nor does noise.
    for exposure in exposures:
        np.testing.assert_array_equal(exposure.vignette, 0)
        np.testing.assert_array_equal(exposure.unevenness, 0)
        plain = exposure._replace(vignette=None)
        exposed = (GridViews(field).exposed(of) for of in (exposure, plain))
        for one, other in zip(*exposed, strict=True):
            np.testing.assert_array_equal(one.planes, other.planes)


def smooth(*, strength=0.05, size=SIZE, views=5, seed=4):
    """Logs of the vignettes of the crosshair's views, and their coefficients: closed form."""
    rng = np.random.default_rng(seed)
    known = strength * rng.standard_normal((views, views, 4, 4))
    order = np.maximum.outer(np.arange(4), np.arange(4))
    known *= np.select([order == 1, order == 2], [1, 0.5], 0.25) * (order > 0)
    middle = np.arange(views) == views // 2
    known[~np.add.outer(middle, middle)] = known[views // 2, views // 2] = 0
    axes = [(2 * np.arange(n) + 1) / n - 1 for n in size]
    down, across = (np.polynomial.legendre.legvander(t, 3) * np.sqrt([1, 3, 5, 7]) for t in axes)
    return known, np.einsum("vukl,yk,xl->vuyx", known, down, across)


def vignetted(light_field, logs):
    # Not so bright that anything is clipped.
    views = 0.7 * np.asarray(light_field.views, np.float64) * np.exp(logs)[..., None]
    return LightField(
        jnp.asarray(views, light_field.views.dtype), disparity_range=light_field.disparity_range
    )


def left(exposure, logs, gain: np.ndarray = NONE):
    """Log of what the views are still off by, once vignettes and gains are taken out."""
    factors = np.asarray(exposure.factors(..., logs.shape[2:])) / float(exposure.scale)
    return (logs + np.log(gain[..., None, None] * factors))[CROSS]


@pytest.mark.parametrize(("sigma", "bar"), [(0.0, 0.002), (0.02, 0.006)])
def test_known_vignettes_are_recovered_beside_gains(bright, sigma, bar):
    gain, (known, logs) = cross_gains(spread=0.03), smooth()
    rough, along = both(changed(vignetted(bright, logs), gain=gain, noise=sigma))
    assert 0.05 < logs[CROSS].std() < 0.15
    before = left(Exposure(ONE, jnp.ones((5, 5), jnp.float32)), logs, gain).std()
    assert left(rough, logs, gain).std() < 0.25 * before
    assert left(along, logs, gain).std() < bar
    np.testing.assert_allclose(np.asarray(along.vignette), known, atol=4 * bar)
    assert np.abs(np.asarray(along.vignette)[~CROSS]).max() < 1e-6
    np.testing.assert_allclose(along.unevenness, logs.std((2, 3)), atol=4 * bar)


def test_gains_and_vignettes_of_all_views_are_recovered(bright):
    gain = 1 + 0.05 * np.random.default_rng(3).standard_normal((5, 5)).astype(np.float32)
    gain[2, 2] = 1
    _, logs = smooth()
    field = changed(vignetted(bright, logs), gain=gain, bits=False)
    every, cross = (exposure_along(field, ONE, FLAT, every=which) for which in (True, False))
    assert np.abs(np.asarray(every.gain) / gain - 1).max() < 0.003
    np.testing.assert_allclose(
        np.asarray(every.gain)[CROSS], np.asarray(cross.gain)[CROSS], atol=1e-3
    )
    assert left(every, logs, gain).std() < 0.003
    ratio = np.asarray(expose(field, every).views)[CROSS] / (0.7 * np.asarray(bright.views))[CROSS]
    assert np.abs(ratio - 1).mean() < 0.003


def test_what_moves_by_itself_is_an_outlier_and_a_dark_half_is_left_to_the_other(bright):
    _, logs = smooth(strength=0.03)
    field = vignetted(bright, logs)
    # A tenth of a view shows something else, brighter by half.
    spoiled = LightField(field.views.at[2, 0, 20:50, 30:60].multiply(1.5))
    assert left(exposure_along(spoiled, ONE, FLAT), logs).std() < 0.004
    rough, along = both(LightField(field.views.at[:, :, :, 70:].set(0)))
    assert all(np.isfinite(np.asarray(each.vignette)).all() for each in (rough, along))
    assert left(along, logs)[:, :, :60].std() < 0.01


def test_what_all_lenses_have_in_common_is_seen_by_parallax():
    """Surfaces of different disparities, side by side; one of a single disparity does not tell."""
    field = synthetic.render(
        synthetic.scene("edges"), shape=(5, 5, 96, 112), samples=1, key=jax.random.key(0)
    )
    assert field.truth is not None
    y, x = np.mgrid[:96, :112] - np.array([95, 111])[:, None, None] / 2
    logs = np.log(1 - 0.4 * (x**2 + y**2) / (x**2 + y**2).max())
    for of, log, disparity in (
        (field, logs, field.truth.disparity),
        (field, np.zeros((1, 1)), field.truth.disparity),
        (textured(), logs, FLAT),
    ):
        found = exposure_along(
            vignetted(of, np.broadcast_to(log, (5, 5, *log.shape))), ONE, disparity
        )
        factor = np.asarray(found.factors(..., SIZE))[2, 2]
        if of is field and log is logs:
            assert (logs + np.log(factor)).std() < 0.4 * logs.std()
            assert float(found.unevenness.max()) < 0.03
        else:
            np.testing.assert_array_equal(factor, 1)


def test_a_missing_view_has_neither_gain_nor_vignette_and_changes_no_other(bright):
    gain, (_, logs) = cross_gains(spread=0.03), smooth()
    field = changed(vignetted(bright, logs), gain=gain)
    there = jnp.ones((5, 5), bool).at[2, 0].set(False)

    @jax.jit  # where the crosshair may have gaps
    def found(views):
        return [(e.gain, e.vignette) for e in both(LightField(views, available=there))]

    first, *others = (found(field.views.at[2, 0].set(value)) for value in (0.0, 0.9))
    assert all(map(np.array_equal, jax.tree.leaves(first), jax.tree.leaves(others)))
    for gains, vignettes in first:
        assert float(gains[2, 0]) == 1
        np.testing.assert_array_equal(vignettes[2, 0], 0)
        # And the others keep theirs.
        np.testing.assert_allclose(gains[2, 4], gain[2, 4], rtol=0.02)
        assert float(jnp.abs(vignettes[2, 4]).max()) > 0.01


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_constant_views_are_left_finite(bright, value):
    field = LightField(jnp.full_like(bright.views, value), disparity_range=(-1, 1))
    for exposure in both(field):
        assert 1 <= float(exposure.scale) <= 16
        np.testing.assert_allclose(exposure.gain, 1, atol=1e-6)


def test_gradients_and_jit():
    field = textured(views=3, size=(32, 40), dtype=np.float64, low=0.2)
    field = changed(field, gain=cross_gains(3), bits=False)
    field = vignetted(field, smooth(size=(32, 40), views=3)[1])
    weights = jax.random.normal(jax.random.key(1), (2, 17, 3, 3), jnp.float64)
    disparity = 0.5 + 0.05 * jax.random.normal(jax.random.key(2), (32, 40), jnp.float64)

    def loss(tree):
        views, disparity = tree
        exposures = both(LightField(views), disparity)
        total = exposures[0].scale
        for exposure, weight in zip(exposures, weights, strict=True):
            total = total + jnp.sum(weight[0] * exposure.gain)
            total = total + jnp.sum(weight[1:].reshape(3, 3, 4, 4) * exposure.vignette)
        return total

    tree = (field.views, disparity)
    check_gradient(loss, tree, rtol=1e-4, step=2e-9, key=jax.random.key(0))
    np.testing.assert_allclose(loss(tree), jax.jit(loss)(tree), rtol=1e-10)


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
def test_a_light_field_of_uneven_lenses_is_as_good_as_one_of_even_ones():
    """The chain on `mvedge render --vignette .4 --gain .02`, 8 bits."""
    scene, shape = synthetic.scene("slanted"), (9, 9, 128, 128)
    found = []
    for seen in (scene, scene.through_lenses(vignette=0.4, vignette_shift=0.05, gain=0.02)):
        field = synthetic.render(seen, shape=shape, samples=2, key=jax.random.key(0))
        field = eqx.tree_at(lambda f: f.views, field, jnp.round(255 * field.views) / 255)
        assert field.truth is not None
        result = EdgeDepth.for_light_field(field)(field).check()
        scores = depth_scores(result.disparity, field.truth.disparity, crop=4)
        found.append((result.stats.exposure.unevenness.max(), scores))
    (even, clean), (uneven, vignetted) = found
    assert float(even) == 0
    assert 0.02 < float(uneven) < 0.2
    # Without: 2.5 times the mean error, 15 % beyond .07 px instead of 6 %.
    for score in ("mse", "mae", "bad_03", "bad_07"):
        assert float(getattr(vignetted, score)) < 1.1 * float(getattr(clean, score)), score
