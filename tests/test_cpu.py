"""Stages and stacks: what they are for is speed, what they must not change is any value."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import check_modes

from mvedge_jax._cpu import checkpoint_stage, no_fuse, plane_sum, unstack


def _stage(tree, shift):
    a, b = tree
    return {"sine": jnp.sin(a) * b + shift, "whole": jnp.floor(a).astype(jnp.int32), "none": None}


def test_a_stage_is_its_function_in_value_and_in_every_derivative():
    key = jax.random.split(jax.random.key(0))
    tree = tuple(jax.random.normal(k, (3, 4)) for k in key)
    shift = jnp.asarray(0.3)
    for wrapped in (checkpoint_stage(_stage), lambda *of: no_fuse(_stage, *of)):
        found, expected = jax.jit(wrapped)(tree, shift), _stage(tree, shift)
        np.testing.assert_allclose(found["sine"], expected["sine"], rtol=1e-15)
        np.testing.assert_array_equal(found["whole"], expected["whole"])
        assert found["none"] is None

        def loss(of, wrapped=wrapped):
            return jnp.sum(wrapped(*of)["sine"] ** 3)

        check_modes(loss, (tree, shift), rtol=1e-6, key=key[0])


def test_other_devices_have_no_fence(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    plain = str(jax.make_jaxpr(lambda x: no_fuse(jnp.sin, x))(1.0))
    assert "cond" not in plain
    np.testing.assert_array_equal(no_fuse(jnp.sin, 1.0), jnp.sin(1.0))


def _of_each(stack):
    parts = [jnp.sum(jnp.sin((i + 1) * plane)) for i, plane in enumerate(unstack(stack))]
    return sum(parts[1:], parts[0])


def _of_sum(stack):
    return jnp.sum(jnp.sin(plane_sum(stack**2)))


@pytest.mark.parametrize(("loss", "concatenations"), [(_of_each, 1), (_of_sum, 0)])
def test_planes_and_their_sum_have_a_transpose_that_is_one_step(loss, concatenations):
    stack = jax.random.normal(jax.random.key(0), (5, 3, 2))
    np.testing.assert_array_equal(unstack(stack), list(stack))
    np.testing.assert_allclose(plane_sum(stack), stack.sum(0), rtol=1e-14, atol=1e-15)
    assert unstack(stack[:0]) == []
    np.testing.assert_array_equal(plane_sum(stack[:0]), jnp.zeros((3, 2)))
    pulled = str(jax.make_jaxpr(jax.vjp(loss, stack)[1])(1.0))
    assert pulled.count("concatenate") == concatenations
    assert "pad" not in pulled
    check_modes(loss, stack, rtol=1e-6, key=jax.random.key(1))
