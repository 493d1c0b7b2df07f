"""Splatting: against every point at every pixel, derivatives, and sets of any kind."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes, count_traces, with_values
from splatting.reference import splat_reference

from mvedge_jax import splatting
from mvedge_jax.splatting import SplatRaster, SplatWidths

SHAPE = (21, 27)
splat = eqx.filter_jit(splatting.splat)
# Wide enough that the oracle, which cuts nothing, agrees to rounding.
WIDE = SplatRaster(radius=14, lanes=7)
PLAIN = (SplatWidths(), SHAPE, SplatRaster())


def cloud(n=40, dtype: type = np.float64):
    """Positions, labels, weights and whether points are there, a fifth of them not."""
    rng = np.random.default_rng(0)
    xy = rng.uniform([-3, -3], [SHAPE[1] + 2, SHAPE[0] + 2], (n, 2))
    label, weight = rng.normal(size=n), rng.uniform(0.2, 2, n)
    xy, label, weight = (jnp.asarray(part, dtype) for part in (xy, label, weight))
    return xy, label, weight, jnp.asarray(rng.random(n) > 0.2)


def maps(result):
    return jnp.stack([result.label_sum, result.weight, result.transmittance])


def random_functional(function, sizes):
    """A smooth scalar of all three maps, so that every gradient path is exercised."""
    direction = jnp.asarray(np.random.default_rng(5).normal(size=(3, *SHAPE)))

    def value(tree):
        *points, params, opacity = tree
        result = function(*points, cloud()[3], params, SHAPE, sizes, opacity=opacity)
        return jnp.vdot(direction, maps(result)) + jnp.sum(result.label**2)

    return value


@pytest.mark.parametrize(
    "sizes",
    [
        replace(WIDE, absorption="quadrature", order=1, tile=5, lanes=1000),
        replace(WIDE, nearest="smallest", order=3, tile=16),
    ],
)
def test_fast_path_equals_every_point_at_every_pixel(sizes):
    points = cloud()
    fast, slow = (of(*points, SplatWidths(), SHAPE, sizes) for of in (splat, splat_reference))
    np.testing.assert_allclose(maps(fast), maps(slow), atol=1e-13)
    assert int(fast.overflow) == 0
    tree = (*points[:3], SplatWidths(), 0.01 + points[2] / 3)
    fast, slow = (jax.grad(random_functional(of, sizes))(tree) for of in (splat, splat_reference))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-10), fast, slow)


@pytest.mark.parametrize(
    "absorption", ["closed", pytest.param("quadrature", marks=pytest.mark.slow)]
)
def test_both_modes_and_the_second_derivative(absorption):
    sizes = SplatRaster(absorption=absorption, lanes=16)
    tree = (*cloud()[:3], SplatWidths(), 0.3 + cloud()[2] / 3)
    check_modes(random_functional(splat, sizes), tree, rtol=1e-5, key=jax.random.key(5))


def test_masked_points_change_neither_value_nor_gradient():
    xy, label, weight, valid = cloud()

    def value(xy, label, weight):
        return jnp.sum(maps(splat(xy, label, weight, valid, *PLAIN)) ** 2)

    run = jax.value_and_grad(value, (0, 1, 2))
    (one, clean), (two, found) = (
        run(
            jnp.where(valid[:, None], xy, bad),
            jnp.where(valid, label, bad),
            jnp.where(valid, weight, bad),
        )
        for bad in (0.5, jnp.nan)
    )
    assert one == two
    for a, b in zip(clean, found, strict=True):
        np.testing.assert_array_equal(a, b)
        assert float(jnp.abs(a[~valid]).max()) == 0
    # Points that are not finite are left out although they are valid.
    spoilt = splat(xy.at[0, 0].set(jnp.nan), label.at[1].set(jnp.inf), weight, valid, *PLAIN)
    without = splat(xy, label, weight, valid.at[:2].set(False), *PLAIN)
    np.testing.assert_array_equal(maps(spoilt), maps(without))


@pytest.mark.parametrize(
    ("nearest", "opacity", "expected"),
    [("largest", 1.0, 2.0), ("smallest", 1.0, 0.5), ("largest", 1e-6, 0.5)],
)
def test_the_nearest_label_wins_unless_it_is_transparent(nearest, opacity, expected):
    points = (
        jnp.array([[10, 10], [10.2, 10]]),
        jnp.array([0.5, 2.0]),
        jnp.ones(2),
        jnp.ones(2, bool),
    )
    raster, opacity = SplatRaster(nearest=nearest), jnp.array([1.0, opacity])
    found = splat(*points, SplatWidths(), SHAPE, raster, opacity=opacity).label[10, 10]
    assert float(found) == pytest.approx(expected, abs=1e-4 if opacity[1] == 1 else 1e-3)


def test_capacity_drops_the_farthest_and_counts_them():
    n, shape = jnp.arange(12.0), (8, 8)
    points = 3.5 + 0.01 * jnp.stack([n, n], 1), 0.1 * n, jnp.ones(12)
    sizes = SplatRaster(capacity=5)
    limited = splat(*points, jnp.ones(12, bool), SplatWidths(), shape, sizes)
    nearest = splat(*points, n >= 7, SplatWidths(), shape, SplatRaster())
    assert (int(limited.overflow), int(limited.longest)) == (7, 12)
    np.testing.assert_array_equal(maps(limited), maps(nearest))


FAR = [[-50.0, 3], [1e9, 2], [4, -1e9], [3, 400], [-6.5, 3], [40, 40]]


@pytest.mark.parametrize("case", ["no capacity", "none valid", "outside", "zero"])
def test_degenerate_sets_are_defined_with_finite_gradients(case):
    n = 0 if case == "no capacity" else 6
    xy = jnp.asarray(FAR) if case == "outside" else jnp.full((n, 2), 5.0)
    label, valid = (jnp.full(n, 0.0 if case == "zero" else 0.7), jnp.full(n, case != "none valid"))

    def value(xy, label, weight):
        result = splat(xy, label, weight, valid, *PLAIN)
        return jnp.sum(maps(result)) + jnp.sum(result.label), result

    found = jax.value_and_grad(value, (0, 1, 2), has_aux=True)(xy, label, jnp.ones(n))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(found))
    result = found[0][1]
    if case == "zero":
        assert float(result.label[5, 5]) == pytest.approx(0, abs=1e-6)
    else:
        for part, nothing in zip((*maps(result), result.label), (0, 0, 1, 0), strict=True):
            np.testing.assert_array_equal(part, nothing)


def test_jit_vmap_and_one_trace():
    xy, label, weight, valid = cloud(20)

    def run(shift):
        widths = SplatWidths(density=5.0 + shift)
        return maps(splatting.splat(xy, label * shift, weight, valid, widths, SHAPE, SplatRaster()))

    traced, traces = count_traces(run)
    shifts = jnp.array([0.0, 0.3, -1.2])
    loop = jnp.stack([traced(shift) for shift in shifts])
    assert traces() == 1
    np.testing.assert_allclose(jax.jit(jax.vmap(run))(shifts), loop, atol=1e-12)
    np.testing.assert_allclose(run(shifts[1]), loop[1], atol=1e-12)


def test_float32_is_close_to_float64_and_absorptions_sum_to_one():
    xy, label, weight, valid = cloud(dtype=np.float32)
    exact, single = splat(*cloud(), *PLAIN), splat(xy, label, weight, valid, *PLAIN)
    assert single.weight.dtype == jnp.float32
    assert float(jnp.abs(maps(exact) - maps(single).astype(float)).max()) < 2e-5
    ones = splat(xy, jnp.ones_like(weight), weight, valid, *PLAIN)
    assert float(jnp.abs(ones.label_sum + ones.transmittance - 1).max()) < 1e-6


def with_widths(**change):
    return splatting.splat(*cloud(), with_values(SplatWidths, **change), *PLAIN[1:])


@pytest.mark.parametrize(
    ("make", "change", "message"),
    [
        (SplatRaster, {"scale": 3}, "scale must be 1 or 2 .* got 3"),
        (SplatRaster, {"nearest": "front"}, "nearest must be .* got 'front'"),
        (SplatRaster, {"absorption": "exact"}, "absorption must be .* got 'exact'"),
        (SplatRaster, {"order": 0}, "order must be at least 1, got 0"),
        (SplatRaster, {"capacity": 0}, "capacity must be None or at least 1, got 0"),
        (with_widths, {"sigma_label": 0.0}, "`sigma_label` must be positive, got 0.0"),
        (with_widths, {"sigma_weight": np.nan}, "`sigma_weight` must be positive, got nan"),
        (with_widths, {"density": 0.0}, "`density` and `sigma_depth` must be positive, got 0 and"),
        (with_widths, {"sigma_label": 3.0}, "sigma_label` = 3 px still count .* `radius` = 6 px"),
        (with_widths, {"sigma_weight": 3.0}, "sigma_weight` = 3 px still count .* `radius` = 6 px"),
    ],
)
def test_bad_numbers_say_what_is_wrong(make, change, message):
    with pytest.raises(ValueError, match=message):
        make(**change)


@pytest.mark.parametrize("order", [2, 26])
def test_steep_weights_have_finite_derivatives_in_float32(order):
    """The place of no point is far away: powers of its distance must not overflow."""
    xy, label, weight, _ = (part[:2] for part in cloud(dtype=np.float32))
    params = jax.tree.map(lambda a: a.astype(jnp.float32), SplatWidths())
    sizes, there = SplatRaster(order=order), jnp.array([True, False])

    def total(params):
        return splatting.splat(xy + 4, label, weight, there, params, SHAPE, sizes).weight.sum()

    @jax.jit
    def both(params):
        ones = jax.tree.map(jnp.ones_like, params)
        return jax.tree.leaves(jax.grad(total)(params)), jax.jvp(total, (params,), (ones,))[1]

    gradient, slope = both(params)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in gradient)
    assert float(slope) == pytest.approx(sum(map(float, gradient)), rel=1e-4)


@pytest.mark.parametrize("name", ["sigma_label", "sigma_weight"])
def test_what_traced_widths_cut_off_is_a_number(name):
    """Within the radius the maps are the oracle's; beyond it `cut_off` says that they are not."""
    points, sizes, errors = cloud(), SplatRaster(), {True: [], False: []}
    run = jax.jit(lambda p: splatting.splat(*points, p, SHAPE, sizes))
    oracle = jax.jit(lambda p: splat_reference(*points, p, SHAPE, sizes))
    default = float(getattr(SplatWidths(), name))
    for width in (0.7 * default, default, 1.3 * default, 3.0, 6.0):
        params = with_values(SplatWidths, **{name: width})
        found, exact = run(params), oracle(params)
        lost, error = (float(found.cut_off), float(jnp.abs(maps(found) - maps(exact)).max()))
        try:
            within = sizes.check(params) is None
        except ValueError:
            within = False
        assert (lost <= 1e-3) == within == (found.problems() == ())
        # Several points at a pixel, each of a label or weight of at most about 2.
        assert error <= 8 * lost
        errors[within].append(error)
    assert max(errors[True]) < 2e-3
    assert max(errors[False]) > 0.1
