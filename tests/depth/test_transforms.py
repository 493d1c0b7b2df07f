"""What the page on gradients says about transforms: each of them traces, with these shapes."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr

from mvedge_jax import EdgeDepth, LightField, batched

pytestmark = pytest.mark.slow  # half a minute of tracing

FIELD = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))


@pytest.fixture(scope="module")
def model():
    choices = {"refine.sharpen.levels": 4, "refine.sharpen.radius": 2}
    return EdgeDepth.for_light_field(FIELD, choices=choices)


def map_of(model, field=FIELD):
    return model(field).disparity


def _with(views):
    return eqx.tree_at(lambda field: field.views, FIELD, views)


def test_grad_in_the_model_and_in_views(model):
    found = jax.eval_shape(jax.grad(lambda m: map_of(m).sum()), model)
    assert jax.tree.structure(found) == jax.tree.structure(model)
    found = jax.eval_shape(jax.grad(lambda v: map_of(model, _with(v)).sum()), FIELD.views)
    assert found.shape == FIELD.views.shape


def test_filter_grad_in_a_whole_light_field(model):
    found = eqx.filter_eval_shape(eqx.filter_grad(lambda field: map_of(model, field).sum()), FIELD)
    assert found.views.shape == FIELD.views.shape
    assert found.disparity_range.shape == (2,)
    assert found.available is None
    with pytest.raises(TypeError, match="bool"):
        jax.eval_shape(jax.grad(lambda field: map_of(model, field).sum()), FIELD)


def test_vmap_over_models_and_over_views(model):
    many = jax.tree.map(lambda leaf: jnp.stack([leaf, 2 * leaf]), model)
    assert jax.eval_shape(jax.vmap(map_of), many).shape == (2, 16, 16)
    views = jnp.stack([FIELD.views] * 3)
    mapped = jax.vmap(lambda v: map_of(model, _with(v)))
    assert jax.eval_shape(mapped, views).shape == (3, 16, 16)


def test_jit_and_forward_mode(model):
    assert jax.eval_shape(jax.jit(map_of), model).shape == (16, 16)
    ones = jax.tree.map(jnp.ones_like, model)
    _, moved = jax.eval_shape(lambda m, t: jax.jvp(map_of, (m,), (t,)), model, ones)
    assert moved.shape == (16, 16)


def _textured(seed):
    """3x3 views of a plane at disparity 1 with a texture of its own."""
    texture = np.random.default_rng(seed).uniform(0.1, 0.9, (18, 18, 3))
    rows = [[texture[v : v + 16, u : u + 16] for u in range(3)] for v in range(3)]
    return jnp.asarray(rows)


def test_vmap_over_every_number_equals_the_loop(model):
    """One row per number of the model, a tenth above its default, in one `vmap`."""
    base, unravel = jax.flatten_util.ravel_pytree(model)
    rows = base[None] * (1 + 0.1 * jnp.eye(base.size))
    seen = _with(_textured(0))
    one = jax.jit(lambda row: map_of(unravel(row), seen))
    many = jax.jit(jax.vmap(one))(rows)
    assert bool(jnp.isfinite(many).all())
    np.testing.assert_allclose(many, jnp.stack([one(row) for row in rows]), atol=1e-8)
    assert int(jnp.any(many != one(base)[None], axis=(1, 2)).sum()) > 20


def test_batched_settings_equal_the_loop_and_share_what_none_reaches(model):
    """The diffusion's numbers leave brightness, measurement and edges alone."""
    seen = _with(_textured(0))

    def one(row, model, field):
        return map_of(model.replace({"refine.stiffness": row[0], "dense.trust": row[1]}), field)

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

    def count(inner):
        parts = [x for e in inner.eqns for x in jax.tree.leaves(list(e.params.values()))]
        closed = [x.jaxpr for x in parts if isinstance(x, ClosedJaxpr)]
        return len(inner.eqns) + sum(
            map(count, closed + [x for x in parts if isinstance(x, Jaxpr)])
        )

    whole = program.jaxpr.eqns[-1].params["jaxpr"].jaxpr
    loop = next(e for e in reversed(whole.eqns) if e.primitive.name == "scan")
    within = count(loop.params["jaxpr"].jaxpr)
    return count(whole) - within, within


def test_vmap_over_light_fields_equals_the_loop(model):
    views = jnp.stack([_textured(seed) for seed in range(3)])
    one = jax.jit(lambda v: map_of(model, _with(v)))
    many = jax.jit(jax.vmap(one))(views)
    np.testing.assert_allclose(many, jnp.stack([one(v) for v in views]), atol=1e-8)
    assert float(jnp.abs(many[0] - many[1]).max()) > 1e-6


SHARDED = """
import jax
import jax.numpy as jnp

jax.config.update("jax_num_cpu_devices", 2)
from mvedge_jax import EdgeDepth, batched
from mvedge_jax.datasets import synthetic

scene = synthetic.scene("edges")
field = synthetic.render(scene, shape=(3, 3, 24, 24), key=jax.random.key(0)).bare()
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
    assert float(ran.stdout) < 1e-3  # px; rounding, where a median chooses
