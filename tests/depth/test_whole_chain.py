"""The chain at length: transforms of it, least and odd sizes, real scenes, learning."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth.test_edge_depth import FLAT, is_sound, small_model, small_scene, two_colors
from helpers import count_traces, shared_data
from jax.extend.core import ClosedJaxpr, Jaxpr

from mvedge_jax import EdgeDepth, LightField, batched
from mvedge_jax.datasets import load_light_field
from mvedge_jax.depth import depth
from mvedge_jax.edges import scene_range
from mvedge_jax.metrics import boundary_scores, depth_scores
from mvedge_jax.photometry.matching import plane_sweep

pytestmark = pytest.mark.slow
TINY = {"refine.sharpen.levels": 4, "refine.sharpen.radius": 2}


@pytest.fixture(scope="module")
def model():
    return EdgeDepth.for_light_field(FLAT, choices=TINY)


def with_views(views, field=FLAT):
    return eqx.tree_at(lambda f: f.views, field, jnp.asarray(views, field.views.dtype))


def textured(seed):
    """3x3 views of a plane at disparity 1 with a texture of its own."""
    texture = np.random.default_rng(seed).uniform(0.1, 0.9, (18, 18, 3))
    return np.asarray([[texture[v : v + 16, u : u + 16] for u in range(3)] for v in range(3)])


def test_one_trace_serves_every_number():
    scene = small_scene().without_truth()
    model = small_model(scene)
    run, traces = count_traces(lambda m: m(scene).disparity)
    first = run(model)
    second = run(model.replace({"refine.stiffness": 9.0}))
    assert float(jnp.abs(first - second).max()) > 1e-4
    # Selections would drop NaN on its way to the map.
    leaves, tree = jax.tree.flatten(model)
    for index in range(len(leaves)):
        for value in (jnp.nan, jnp.inf, -1.0):
            spoilt = [jnp.full_like(x, value) if i == index else x for i, x in enumerate(leaves)]
            assert np.isnan(run(jax.tree.unflatten(tree, spoilt))).all()
    assert traces() == 1


def test_vmap_over_light_fields_and_over_every_number_is_the_loop(model):
    def one(model, views):
        found = model(with_views(views))
        return found.disparity, found.error

    single = jax.jit(one)
    # Textured, constant, of two colors: each stops on its own.
    flat = np.asarray(FLAT.views)
    every = [textured(0), textured(1), flat, two_colors(flat)]
    leaves, tree = jax.tree.flatten(model)
    moved = [
        tree.unflatten([leaf * 1.1 if i == k else leaf for i, leaf in enumerate(leaves)])
        for k in range(len(leaves))
    ]
    stacked = jax.tree.map(lambda *rows: jnp.stack(rows), *moved)
    for axes, together, alone in (
        ((None, 0), (model, jnp.asarray(every)), [(model, v) for v in every]),
        ((0, None), (stacked, textured(0)), [(m, textured(0)) for m in moved]),
    ):
        both = jax.jit(jax.vmap(one, axes))(*together)
        for index, arguments in enumerate(alone):
            for many, wanted in zip(both, single(*arguments), strict=True):
                np.testing.assert_allclose(many[index], wanted, rtol=0, atol=1e-7)
    here = single(model, textured(0))[0]
    assert int(jnp.any(both[0] != here[None], axis=(1, 2)).sum()) > 20


@pytest.mark.parametrize("color", [0.0, 0.5, 1.0, "two colors"])
def test_gradients_are_finite_where_nothing_is_seen(model, color):
    flat = np.asarray(FLAT.views, np.float32)
    views = two_colors(flat) if color == "two colors" else np.full_like(flat, color)
    field = LightField(jnp.asarray(flat), disparity_range=FLAT.disparity_range)

    @jax.jit
    def gradient(model, views):
        def total(model, views):
            found = model(with_views(views, field))
            return found.disparity.sum() + found.error.sum()

        return jax.grad(total, argnums=(0, 1))(model, views)

    for leaf in jax.tree.leaves(gradient(model, jnp.asarray(views))):
        assert bool(jnp.isfinite(leaf).all())


def test_filter_grad_in_a_whole_light_field(model):
    def total(field):
        return model(field).disparity.sum()

    found = eqx.filter_eval_shape(eqx.filter_grad(total), FLAT)
    assert found.views.shape == FLAT.views.shape
    assert found.disparity_range.shape == (2,)
    assert found.available is None
    with pytest.raises(TypeError, match="bool"):
        jax.eval_shape(jax.grad(total), FLAT)


def test_batched_settings_equal_the_loop_and_share_what_none_reaches(model):
    """The diffusion's numbers leave brightness, measurement and edges alone."""
    seen = with_views(textured(0))

    def one(row, model, field):
        numbers = {"refine.stiffness": row[0], "dense.trust": row[1]}
        return model.replace(numbers)(field).disparity

    rows = jnp.asarray([[0.5, 1.0], [5.0, 1.5], [50.0, 0.2]])
    many = batched(one, together=2)(rows, model, seen)
    np.testing.assert_allclose(many, jnp.stack([one(row, model, seen) for row in rows]), atol=1e-8)
    assert float(jnp.abs(many[0] - many[-1]).max()) > 1e-3
    shared, mapped = _equations_beside_and_within_the_last_loop(
        jax.make_jaxpr(lambda *of: batched(one, together=2)(*of))(rows, model, seen.bare())
    )
    assert shared > mapped > 100


def _equations_beside_and_within_the_last_loop(program):
    """How many equations are computed once, and how many in the loop over the rows."""

    def count(inner) -> int:
        parts = [x for e in inner.eqns for x in jax.tree.leaves(list(e.params.values()))]
        inner_ones = [x.jaxpr if isinstance(x, ClosedJaxpr) else x for x in parts]
        return len(inner.eqns) + sum(count(x) for x in inner_ones if isinstance(x, Jaxpr))

    whole = program.jaxpr.eqns[-1].params["jaxpr"].jaxpr
    loop = next(e for e in reversed(whole.eqns) if e.primitive.name == "scan")
    within = count(loop.params["jaxpr"].jaxpr)
    return count(whole) - within, within


SHARDED = """
import jax
import jax.numpy as jnp

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)
from mvedge_jax import EdgeDepth, LightField, batched
from mvedge_jax.datasets import synthetic

scene = synthetic.scene("edges")
field = synthetic.render(scene, shape=(3, 3, 24, 24), key=jax.random.key(0))
field = LightField(field.views.astype(float), disparity_range=field.disparity_range)
model = EdgeDepth.for_light_field(field)


def one(stiffness):
    return model.replace({"refine.stiffness": stiffness})(field).disparity


values = jnp.asarray([0.5, 5.0, 50.0, 500.0])
found = batched(one, devices=jax.devices())(values)
assert len(found.sharding.device_set) == 2
in_turn = jnp.stack([one(value) for value in values])
assert float(abs(in_turn[0] - in_turn[-1]).max()) > 0.1
print(float(abs(found - in_turn).max()))
"""


def test_settings_spread_over_devices_are_those_in_turn():
    ran = subprocess.run([sys.executable, "-c", SHARDED], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert float(ran.stdout) < 1e-6  # px


LEAST = [(3, 3, 1, 1), (3, 3, 1, 40), (3, 3, 40, 1), (1, 3, 2, 3), (3, 1, 24, 24)]
ODD = [(3, 3, 64, 64), (5, 9, 40, 70), (1, 5, 33, 47), (3, 3, 24, 24), (3, 3, 768, 1024)]


@pytest.mark.parametrize(
    ("shape", "what"),
    [
        *((shape, what) for shape in LEAST for what in ("one color", "two colors")),
        *((shape, "noise") for shape in ODD),
    ],
)
def test_any_shape_gives_a_finite_map(shape, what):
    views = np.full((*shape, 3), (0.5, 0.4, 0.6), np.float32)
    if what == "two colors":
        views = two_colors(views)
    elif what == "noise":
        views = np.random.default_rng(0).uniform(size=views.shape).astype(np.float32)
    wide, choices = ((-3.5, 3.5), {}) if what == "noise" else ((-1.0, 2.0), TINY)
    field = LightField(jnp.asarray(views), disparity_range=wide)
    found = EdgeDepth.for_light_field(field, choices=choices)(field)
    assert found.disparity.shape == shape[2:]
    is_sound(found)


def expected_to_fail(name, reason):
    return pytest.param(name, marks=pytest.mark.xfail(strict=True, reason=reason))


@pytest.mark.parametrize(
    "name",
    ["demo", expected_to_fail("edges", "all is flat there: what is learned makes slopes worse")],
)
def test_adam_mends_bad_numbers_on_another_scene_too(name):
    """From a bad start: with the defaults, what a step gains is less than what single pixels do."""
    import optax

    train, test = small_scene(name), small_scene("slanted")
    models = [small_model(f) for f in (train, test)]
    # The defaults, spoilt by a factor of eight.
    logs = jnp.log(jnp.asarray([0.005 / 8, 1.4 * 8, 1.5 / 8]))

    def loss(logs, field, model):
        paths = "refine.precision", "dense.trust", "refine.stiffness"
        moved = model.replace(dict(zip(paths, jnp.exp(logs), strict=True)))
        found = moved(field.without_truth()).disparity
        return jnp.mean(jnp.abs(found - field.truth.disparity))

    optimizer = optax.adam(0.1)
    state = optimizer.init(logs)
    step = eqx.filter_jit(jax.value_and_grad(lambda p: loss(p, train, models[0])))
    before = [float(loss(logs, f, m)) for f, m in zip((train, test), models, strict=True)]
    for _ in range(30):
        _, gradient = step(logs)
        # Optax divides by an integer count.
        with jax.numpy_dtype_promotion("standard"):
            updates, state = optimizer.update(gradient, state)
        logs = optax.apply_updates(logs, updates)
    after = [float(loss(logs, f, m)) for f, m in zip((train, test), models, strict=True)]
    assert after[0] < 0.95 * before[0], (before, after)
    assert after[1] < before[1], (before, after)


@pytest.mark.parametrize(
    ("name", "views", "bars"),
    [
        ("cotton", "crosshair", (0.306, 0.171, 13.1, 2.7, 0.95)),
        ("backgammon", "crosshair", (1.80, 0.127, 7.4, 1.92, 1.15)),
        ("cotton", "all", (0.303, 0.135, 9.6, 2.3, 0.95)),
        ("backgammon", "all", (1.83, 0.083, 7.7, 1.67, 1.06)),
    ],
)
def test_benchmark_scenes(name, views, bars):
    """Today's figures, and a tenth."""
    light_field = load_light_field(shared_data("hci", name))
    result = EdgeDepth.for_light_field(light_field, views=views)(light_field.without_truth())
    truth = light_field.truth
    assert truth is not None
    scores = depth_scores(result.disparity, truth.disparity, mask=truth.valid)
    found = (scores.mse, scores.q25, scores.bad_01, scores.bad_03, scores.bad_07)
    assert all(float(a) <= b for a, b in zip(found, bars, strict=True)), found


TIPS = "tips of wedges, two pixels wide, are diffused away: docs/differences.md"


@pytest.mark.parametrize("name", ["cotton", expected_to_fail("backgammon", TIPS)])
def test_boundaries_are_better_than_those_of_a_plane_sweep(name):
    light_field = load_light_field(shared_data("hci", name))
    blind, truth = light_field.without_truth(), light_field.truth
    assert truth is not None
    swept = plane_sweep(blind, disparity_range=scene_range(blind)).disparity
    found = depth(blind).disparity
    ours, theirs = (boundary_scores(d, truth.disparity, mask=truth.valid) for d in (found, swept))
    assert float(ours.peak_f1) > float(theirs.peak_f1)
    assert float(ours.auc) > float(theirs.auc)


def test_a_real_light_field():
    result = depth(load_light_field(shared_data("lytro", "2067"), views=7))
    assert bool(jnp.isfinite(result.disparity).all())
    assert int(result.stats.edges.valid) > 5000


def test_rounding_does_not_turn_the_gradient():
    whole = load_light_field(shared_data("hci", "cotton")).without_truth()
    field = eqx.tree_at(lambda f: f.views, whole, whole.views[:, :, 128:320, 128:320])
    model = EdgeDepth.for_light_field(field)

    @jax.jit
    def gradient(views):
        return jax.grad(lambda v: jnp.mean(jnp.sin(3 * model(with_views(v, field)).disparity)))(
            views
        )

    exact = np.asarray(gradient(field.views), np.float64).ravel()
    for seed in range(2):
        noise = jax.random.uniform(
            jax.random.key(seed), field.views.shape, field.views.dtype, minval=-1.0
        )
        moved = np.asarray(gradient(field.views + 1e-7 * noise), np.float64).ravel()
        assert exact @ moved > 0.97 * np.linalg.norm(exact) * np.linalg.norm(moved)
