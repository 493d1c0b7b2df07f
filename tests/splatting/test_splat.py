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


def cloud(n=40, dtype: type = np.float64, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform([-3, -3], [SHAPE[1] + 2, SHAPE[0] + 2], (n, 2))
    label, weight = rng.normal(size=n), rng.uniform(0.2, 2, n)
    return (
        jnp.asarray(xy.astype(dtype)),
        jnp.asarray(label.astype(dtype)),
        jnp.asarray(weight.astype(dtype)),
        jnp.asarray(rng.random(n) > 0.2),
    )


def maps(result):
    return jnp.stack([result.label_sum, result.weight, result.transmittance])


def random_functional(function, sizes):
    """A smooth scalar of all three maps, so that every gradient path is exercised."""
    direction = jnp.asarray(np.random.default_rng(5).normal(size=(3, *SHAPE)))

    def value(tree):
        xy, label, weight, params, opacity = tree
        valid = cloud()[3]
        result = function(xy, label, weight, valid, params, SHAPE, sizes, opacity=opacity)
        return jnp.vdot(direction, maps(result)) + jnp.sum(result.label**2)

    return value


@pytest.mark.parametrize(
    "sizes",
    [
        WIDE,
        replace(WIDE, absorption="quadrature", order=1, tile=5, lanes=1000),
        replace(WIDE, nearest="smallest", order=3, tile=16),
    ],
    ids=["closed", "quadrature", "depth"],
)
def test_fast_path_equals_every_point_at_every_pixel(sizes):
    points = cloud()
    fast = splat(*points, SplatWidths(), SHAPE, sizes)
    slow = splat_reference(*points, SplatWidths(), SHAPE, sizes)
    np.testing.assert_allclose(maps(fast), maps(slow), atol=1e-13)
    assert int(fast.overflow) == 0
    tree = (*points[:3], SplatWidths(), 0.01 + points[2] / 3)
    gradient_fast = jax.grad(random_functional(splat, sizes))(tree)
    gradient_slow = jax.grad(random_functional(splat_reference, sizes))(tree)
    for a, b in zip(jax.tree.leaves(gradient_fast), jax.tree.leaves(gradient_slow), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10)


@pytest.mark.parametrize("absorption", ["closed", "quadrature"])
def test_both_modes_and_the_second_derivative(absorption):
    sizes = SplatRaster(absorption=absorption, lanes=16)
    tree = (*cloud()[:3], SplatWidths(), 0.3 + cloud()[2] / 3)
    check_modes(random_functional(splat, sizes), tree, rtol=1e-5, key=jax.random.key(5))


@pytest.mark.parametrize("border", [7.5, 8.0, 9.0])
def test_crossing_a_pixel_or_tile_border_changes_nothing_abruptly(border):
    run = jax.jit(lambda xy: maps(splat(xy, label, weight, valid, SplatWidths(), SHAPE, sizes)))
    sizes = SplatRaster()
    label, weight, valid = jnp.array([1.0, 0.4]), jnp.ones(2), jnp.ones(2, bool)
    other = jnp.array([12.3, 9.1])
    sides = [
        run(jnp.stack([jnp.array([border + offset, border + 0.3 + offset]), other]))
        for offset in (-1e-6, 1e-6)
    ]
    assert float(jnp.abs(sides[0] - sides[1]).max()) < 1e-3


def test_masked_points_change_neither_value_nor_gradient():
    xy, label, weight, valid = cloud()

    def value(tree):
        xy, label, weight = tree
        result = splat(xy, label, weight, valid, SplatWidths(), SHAPE, SplatRaster())
        return jnp.sum(maps(result) ** 2)

    spoiled = (
        jnp.where(valid[:, None], xy, jnp.nan),
        jnp.where(valid, label, jnp.inf),
        jnp.where(valid, weight, jnp.nan),
    )
    one, gradient_one = jax.value_and_grad(value)((xy, label, weight))
    two, gradient_two = jax.value_and_grad(value)(spoiled)
    assert one == two
    for a, b in zip(gradient_one, gradient_two, strict=True):
        np.testing.assert_array_equal(a, b)
        assert float(jnp.abs(a[~valid]).max()) == 0
    # Points that are not finite are left out although they are valid.
    few, rest = valid.at[:2].set(False), (SplatWidths(), SHAPE, SplatRaster())
    found = splat(xy.at[0, 0].set(jnp.nan), label.at[1].set(jnp.inf), weight, valid, *rest)
    np.testing.assert_array_equal(maps(found), maps(splat(xy, label, weight, few, *rest)))


@pytest.mark.parametrize(
    ("nearest", "opacity", "expected"),
    [("largest", 1.0, 2.0), ("smallest", 1.0, 0.5), ("largest", 1e-6, 0.5)],
)
def test_the_nearest_label_wins_unless_it_is_transparent(nearest, opacity, expected):
    xy = jnp.array([[10.0, 10.0], [10.2, 10.0]])
    points = xy, jnp.array([0.5, 2.0]), jnp.ones(2), jnp.ones(2, bool)
    result = splat(
        *points, SplatWidths(), SHAPE, SplatRaster(nearest=nearest),
        opacity=jnp.array([1.0, opacity]),
    )  # fmt: skip
    tolerance = 1e-4 if opacity == 1 else 1e-3
    assert float(result.label[10, 10]) == pytest.approx(expected, abs=tolerance)


def test_capacity_drops_the_farthest_and_counts_them():
    n = 12
    xy = 3.5 + 0.01 * jnp.tile(jnp.arange(n, dtype=float)[:, None], (1, 2))
    label, weight, valid = jnp.arange(n, dtype=float) * 0.1, jnp.ones(n), jnp.ones(n, bool)
    shape, sizes = (8, 8), SplatRaster(capacity=5)
    limited = splat(xy, label, weight, valid, SplatWidths(), shape, sizes)
    nearest = splat(xy, label, weight, jnp.arange(n) >= n - 5, SplatWidths(), shape, SplatRaster())
    assert int(limited.overflow) == n - 5
    assert int(limited.longest) == n
    np.testing.assert_array_equal(maps(limited), maps(nearest))


@pytest.mark.parametrize("case", ["no capacity", "none valid", "outside", "equal", "zero"])
def test_degenerate_sets_are_defined_with_finite_gradients(case):
    n = 0 if case == "no capacity" else 6
    xy = jnp.full((n, 2), 5.0)
    if case == "outside":
        xy = jnp.array(
            [[-50.0, 3.0], [1e9, 2.0], [4.0, -1e9], [3.0, 400.0], [-6.5, 3.0], [40.0, 40.0]]
        )
    label = jnp.zeros(n) if case == "zero" else jnp.full(n, 0.7)
    valid = jnp.full(n, case != "none valid")

    def value(tree):
        xy, label, weight = tree
        result = splat(xy, label, weight, valid, SplatWidths(), SHAPE, SplatRaster())
        return jnp.sum(maps(result)) + jnp.sum(result.label), result

    (_, result), gradient = jax.value_and_grad(value, has_aux=True)((xy, label, jnp.ones(n)))
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves((result, gradient)))
    if case in ("no capacity", "none valid", "outside"):
        np.testing.assert_array_equal(maps(result)[:2], 0)
        np.testing.assert_array_equal(result.transmittance, 1)
        np.testing.assert_array_equal(result.label, 0)
    else:
        assert float(result.label[5, 5]) == pytest.approx(float(label[0]), abs=1e-6)


def test_equal_depths_are_ordered_by_index():
    points = jnp.full((2, 2), 5.0), jnp.full(2, 0.3), jnp.array([1.0, 4.0]), jnp.ones(2, bool)
    result = splat(*points, SplatWidths(), SHAPE, SplatRaster())
    assert float(result.weight[5, 5]) == pytest.approx(1.0, abs=1e-5)


def test_jit_vmap_and_one_trace():
    xy, label, weight, valid = cloud(20)
    sizes = SplatRaster()
    traced, traces = count_traces(lambda p, z: maps(splat(xy, z, weight, valid, p, SHAPE, sizes)))
    shifts = jnp.array([0.0, 0.3, -1.2])
    loop = jnp.stack([traced(SplatWidths(density=5.0 + s), label * s) for s in shifts])
    assert traces() == 1
    params = eqx.filter_vmap(lambda s: SplatWidths(density=5.0 + s))(shifts)
    batch = jax.vmap(lambda p, s: maps(splat(xy, label * s, weight, valid, p, SHAPE, sizes)))(
        params, shifts
    )
    np.testing.assert_allclose(batch, loop, atol=1e-12)
    widths = SplatWidths(density=jnp.asarray(5.3))
    eager = splatting.splat(xy, label * 0.3, weight, valid, widths, SHAPE, sizes)
    np.testing.assert_allclose(maps(eager), loop[1], atol=1e-12)


def test_float32_is_close_to_float64_and_absorptions_sum_to_one():
    wide, narrow = cloud(), cloud(dtype=np.float32)
    exact = splat(*wide, SplatWidths(), SHAPE, SplatRaster())
    single = splat(*narrow, SplatWidths(), SHAPE, SplatRaster())
    assert single.weight.dtype == jnp.float32
    assert float(jnp.abs(maps(exact) - maps(single).astype(float)).max()) < 2e-5
    xy, _, weight, valid = narrow
    ones = splat(xy, jnp.ones_like(weight), weight, valid, SplatWidths(), SHAPE, SplatRaster())
    assert float(jnp.abs(ones.label_sum + ones.transmittance - 1).max()) < 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": 3}, "scale must be 1 or 2 .* got 3"),
        ({"nearest": "front"}, "nearest must be .* got 'front'"),
        ({"absorption": "exact"}, "absorption must be .* got 'exact'"),
        ({"order": 0}, "order must be at least 1, got 0"),
        ({"capacity": 0}, "capacity must be None or at least 1, got 0"),
    ],
)
def test_bad_sizes_say_what_is_wrong(change, message):
    with pytest.raises(ValueError, match=message):
        SplatRaster(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma_label": 0.0}, "`sigma_label` must be positive, got 0.0"),
        ({"sigma_weight": float("nan")}, "`sigma_weight` must be positive, got nan"),
        ({"density": 0.0}, "`density` and `sigma_depth` must be positive, got 0 and"),
        ({"sigma_label": 3.0}, "sigma_label` = 3 px still count .* at `radius` = 6 px"),
        ({"sigma_weight": 3.0}, "sigma_weight` = 3 px still count .* at `radius` = 6 px"),
    ],
)
def test_bad_widths_say_what_is_wrong(change, message):
    points = jnp.zeros((1, 2)), jnp.ones(1), jnp.ones(1), jnp.ones(1, bool)
    with pytest.raises(ValueError, match=message):
        splatting.splat(*points, with_values(SplatWidths, **change), SHAPE, SplatRaster())


@pytest.mark.parametrize("order", [2, 6, 26])
def test_steep_weights_have_finite_derivatives_in_float32(order):
    """The place of no point is far away: powers of its distance must not overflow."""
    xy, label, weight, _ = (part[:2] for part in cloud(dtype=np.float32))
    params = jax.tree.map(lambda a: a.astype(jnp.float32), SplatWidths())
    sizes = replace(SplatRaster(), order=order)

    def total(params):
        there = jnp.array([True, False])
        return splatting.splat(xy + 4, label, weight, there, params, SHAPE, sizes).weight.sum()

    gradient = jax.jit(jax.grad(total))(params)
    direction = jax.tree.map(jnp.ones_like, params)
    slope = jax.jit(lambda p: jax.jvp(total, (p,), (direction,))[1])(params)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(gradient))
    assert float(slope) == pytest.approx(sum(float(g) for g in jax.tree.leaves(gradient)), rel=1e-4)


@pytest.mark.parametrize("name", ["sigma_label", "sigma_weight"])
def test_what_traced_widths_cut_off_is_a_number(name):
    """Within the radius the maps are the oracle's; beyond it `cut_off` says that they are not."""
    points, sizes = cloud(), SplatRaster()
    run = jax.jit(lambda p: splatting.splat(*points, p, SHAPE, sizes))
    oracle = jax.jit(lambda p: splat_reference(*points, p, SHAPE, sizes))
    default = float(getattr(SplatWidths(), name))
    seen = []
    for width in (0.7 * default, default, 1.3 * default, 3.0, 6.0):
        params = with_values(SplatWidths, **{name: width})
        found, exact = run(params), oracle(params)
        lost, error = float(found.cut_off), float(jnp.abs(maps(found) - maps(exact)).max())
        within = True
        try:
            sizes.check(params)
        except ValueError:
            within = False
        assert (lost <= 1e-3) == within == (found.problems() == ())
        # Several points at a pixel, each of a label or weight of at most about 2.
        assert error <= 8 * lost
        seen.append((within, error))
    assert max(error for within, error in seen if within) < 2e-3
    assert max(error for within, error in seen if not within) > 0.1
    assert float(oracle(SplatWidths()).cut_off) == 0


def test_problems_of_a_splat_are_sentences():
    points = cloud()
    wide = with_values(SplatWidths, sigma_label=3.0)
    found = jax.jit(lambda p: splatting.splat(*points, p, SHAPE, SplatRaster(capacity=3)))(wide)
    cut, full = found.problems()
    assert cut == (
        "points still count 2.1 at `SplatRaster.radius`, where they are cut off; at most 0.001 is "
        "negligible: ask for a larger radius, or narrower points."
    )
    assert full.startswith(f"{int(found.overflow)} entries of the tiles' lists exceed")
    unknown = jax.jit(lambda p: splatting.splat(*points, p, SHAPE, SplatRaster()))(
        with_values(SplatWidths, sigma_label=jnp.nan)
    )
    assert "count nan" in unknown.problems()[0]


def test_what_is_cut_off_has_no_derivative():
    slope = jax.grad(lambda p: SplatRaster().cut_off(p))(SplatWidths())
    assert all(float(leaf) == 0 for leaf in jax.tree.leaves(slope))
