"""Derivatives outside of `jit` are those of the whole, by programs that outlive a loss."""

import weakref

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored.programs import TRACES, Part, X, chain, scaled, split, split_jit, stored_files

from mvedge_jax._split_jit import Halves, SplitJit

PART = Part(jnp.asarray(2.0), power=jnp.sin)


def _loss(program, part=PART, scale=1.0):
    """Of a result that both halves reach, and one that passes the second."""

    def loss(x):
        found = program(x, part)
        return jnp.sum(jnp.cos(scale * found["a"])) + found["weak"] * found["sum"] ** 2

    return loss


def _whole(x, part, *, key=None):
    first, rest = split(x, part, key=key)
    found, also = scaled(*first)
    return {"a": rest[0](found.power)} | also


def _pulled(loss, x):
    value, pull = jax.vjp(loss, x)
    return value, pull(jnp.ones_like(value)), jax.jit(pull)(2 * jnp.ones_like(value))


def _linearized(loss, x):
    value, push = jax.linearize(loss, x)
    return value, push(X), jax.vmap(push)(jnp.stack([X, X**2]))


TRANSFORMS = {
    "value_and_grad": lambda loss: jax.value_and_grad(loss)(X),
    "vjp": lambda loss: _pulled(loss, X),
    "jvp": lambda loss: jax.jvp(loss, (X,), (X**2,)),
    "linearize": lambda loss: _linearized(loss, X),
    "jacrev": lambda loss: jax.jacrev(loss)(X),
    "forward over reverse": lambda loss: jax.jvp(jax.grad(loss), (X,), (X**2,)),
    "reverse over reverse": lambda loss: jax.grad(lambda x: jax.grad(loss)(x) @ X)(X),
    "vmap of grad": lambda loss: jax.vmap(jax.grad(loss))(jnp.stack([X, X + 1])),
    "grad of vmap": lambda loss: jax.grad(lambda x: jax.vmap(loss)(x).sum())(jnp.stack([X, X])),
    "jit of grad": lambda loss: jax.jit(jax.grad(loss))(X),
    "grad of jit": lambda loss: jax.grad(jax.jit(loss))(X),
    "grad of a constant in jit": lambda loss: jax.jit(lambda: jax.grad(loss)(X))(),
    "checkpoint": lambda loss: jax.grad(jax.checkpoint(loss))(X),
}


@pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=TRANSFORMS)
def test_transforms_are_those_of_the_whole(transform):
    found, whole = (transform(_loss(program)) for program in (split_jit(), _whole))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=2e-5, atol=1e-5), found, whole)


def test_many_results_and_their_pullback():
    """Cotangents of everything, used twice: the residuals are freed and computed again."""
    results, pull = jax.vjp(lambda x: split_jit()(x, PART), X)
    expected, pull_whole = jax.vjp(lambda x: _whole(x, PART), X)
    assert jax.tree.structure(results) == jax.tree.structure(expected)
    for scale in (1.0, -3.0):
        cotangents = jax.tree.map(lambda leaf, scale=scale: scale * leaf, results)
        for a, b in zip(pull(cotangents), pull_whole(cotangents), strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-6)
    jacobian = jax.jacrev(lambda x: split_jit()(x, PART)["a"])(X)
    np.testing.assert_allclose(jacobian, np.diag(2 * np.cos(2 * X)), rtol=1e-6)


def _gradient(program, *, scale=1.0, part=PART, of="both"):
    """A gradient as of a new loss, and which halves were traced for it."""
    before = len(TRACES)
    x, weight = jnp.array(X), jnp.array(part.weight)

    def loss(both):
        x_, weight_ = {"both": both, "x": (both[0], weight), "weight": (x, both[1])}[of]
        return _loss(program, Part(weight_, part.power), scale)(x_)

    return jax.grad(loss)((x, weight)), TRACES[before:]


def test_another_loss_traces_nothing():
    program = split_jit()
    assert _gradient(program)[1] == ["first", "second"]
    found, traced = _gradient(program, scale=0.5)
    assert traced == []
    expected, _ = _gradient(_whole, scale=0.5)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-5, atol=1e-6)
    assert _gradient(program, part=Part(PART.weight, jnp.cos))[1] == ["second"]
    assert _gradient(program, of="x")[1] == ["first"], "a pullback for fewer arguments"
    jax.clear_caches()
    assert _gradient(program)[1] == ["first", "second"]


def test_a_later_process_traces_neither(files):
    usual, traced = _gradient(split_jit())
    assert (traced, len(stored_files(files))) == (["first", "second"], 4)
    found, traced = _gradient(split_jit())
    assert traced == []
    for a, b in zip(found, usual, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("lost", range(4))
def test_a_pullback_is_that_of_its_own_residuals(files, lost):
    """Where one program of a half is lost, both are made anew."""
    usual, _ = _gradient(split_jit())
    stored_files(files)[lost].unlink()
    for traces in (1, 0):
        found, traced = _gradient(split_jit())
        assert len(traced) == traces
        for a, b in zip(found, usual, strict=True):
            np.testing.assert_array_equal(a, b)


def test_what_nothing_is_differentiated_by_has_no_pullback(files):
    program = SplitJit(_late, _late, Halves(_late_split, scaled, _late_second), lambda half: half)
    slope = jax.grad(lambda factor: program(X, factor)["a"].sum())(3.0)
    np.testing.assert_allclose(slope, 2 * X.sum(), atol=1e-6)
    # The value of the first half; functions of this module have no name in later processes.
    assert len(stored_files(files)) == 1


def _late_split(x, factor):
    return (x, jnp.asarray(2.0), None), (factor,)


def _late_second(found, factor):
    return {"a": factor * found[0].power}


def _late(x, factor):
    first, rest = _late_split(x, factor)
    return _late_second(scaled(*first), *rest)


def test_leaves_that_no_half_reads_have_the_derivative_zero():
    def unread(x, part, also):
        return split(x, part)

    program = SplitJit(_unread, _unread, Halves(unread, scaled, _second), lambda half: half)
    slopes = jax.grad(lambda both: program(both[0], PART, both[1])["a"].sum())((X, X[:2]))
    np.testing.assert_allclose(slopes[0], 2 * np.cos(2 * X), rtol=1e-6)
    np.testing.assert_array_equal(slopes[1], [0, 0])


def _second(found, power):
    return {"a": power(found[0].power)}


def _unread(x, part, also):
    first, rest = split(x, part)
    return _second(scaled(*first), *rest)


def test_keys_integers_and_numpy_arrays():
    def slope(program):
        def loss(x):
            return program(x, Part(np.asarray(2.0), jnp.sin), key=jax.random.key(3))["a"].sum()

        return jax.grad(loss)(np.asarray(X))

    np.testing.assert_allclose(slope(split_jit()), slope(_whole), rtol=2e-6)


def test_what_calls_python_is_one_program(files):
    def says(x):
        jax.debug.callback(lambda: TRACES.append("ran"))
        return x**2

    slope = jax.grad(_loss(split_jit(), Part(jnp.asarray(2.0), power=says)))(X)
    jax.effects_barrier()
    assert TRACES[-1] == "ran"
    np.testing.assert_allclose(slope, jax.grad(_loss(chain, Part(jnp.asarray(2.0))))(X), rtol=1e-5)


def test_nothing_outlives_a_gradient():
    program, x = split_jit(), X + 1
    slope = jax.grad(_loss(program))(x)
    del slope
    given = weakref.ref(x)
    del x
    assert given() is None


@pytest.mark.parametrize("wide", [True, False])
def test_settings_of_a_context_hold_for_all(wide):
    with jax.enable_x64(wide):
        x, part = jnp.linspace(-1.0, 1.0, 5), Part(jnp.asarray(2.0), jnp.sin)
        found, whole = (jax.grad(_loss(program, part))(x) for program in (split_jit(), _whole))
        np.testing.assert_allclose(found, whole, rtol=1e-12 if wide else 2e-5, atol=1e-6)
    assert found.dtype == (jnp.float64 if wide else jnp.float32)


def test_of_a_module():
    slope = eqx.filter_grad(lambda part: _loss(split_jit(), part)(X))(PART)
    expected = eqx.filter_grad(lambda part: _loss(_whole, part)(X))(PART)
    assert jax.tree.structure(slope) == jax.tree.structure(expected)
    np.testing.assert_allclose(slope.weight, expected.weight, rtol=1e-5)
