"""Programs ask the compiler for what suits them, wherever JAX lets them ask."""

import functools
import gc
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from mvedge_jax import _compiler, _cpu, compiler_options, lean_jit


def _wave(x, scale):
    return jnp.sin(x) * x * scale


_lean = lean_jit(_wave)
_X = np.linspace(-1.0, 1.0, 7)


def test_options_are_those_that_the_compiler_knows():
    options = compiler_options()
    if not options:
        pytest.skip("this compiler knows none of them")
    program = jax.jit(jnp.sin, compiler_options=options)
    np.testing.assert_allclose(program(_X), np.sin(_X), rtol=1e-12)
    options.clear()
    assert compiler_options(), "what is returned is the caller's own"


@pytest.fixture
def _fresh(monkeypatch):
    """What is known of the compiler is asked anew, before and after."""
    known = functools.cache(_cpu._known.__wrapped__)
    monkeypatch.setattr(_cpu, "_known", known)
    monkeypatch.setattr(_compiler, "_probe", functools.cache(_compiler._probe.__wrapped__))


@pytest.mark.usefixtures("_fresh")
def test_a_compiler_that_does_not_know_them_is_not_asked(monkeypatch):
    monkeypatch.setattr(_cpu, "_WISHES", {"xla_cpu_of_another_time": False})
    assert compiler_options() == {}
    np.testing.assert_allclose(lean_jit(_wave)(jnp.asarray(_X), 2.0), 2 * np.sin(_X) * _X)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert compiler_options() == {}, "nor is that of another device"


@pytest.mark.parametrize("asked", [True, False])
def test_who_wants_no_optimizations_gets_none(asked):
    if not compiler_options():
        pytest.skip("this compiler knows none of them")
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", asked)
    try:
        assert ("xla_backend_optimization_level" in compiler_options()) != asked
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


@pytest.mark.parametrize("enabled", [True, False])
def test_garbage_is_not_collected_in_a_trace(enabled):
    seen = []

    @lean_jit
    def looks(x):
        seen.append(gc.isenabled())
        if x.shape == (2,):
            raise ValueError("no such shape")
        return x

    (gc.enable if enabled else gc.disable)()
    try:
        looks(jnp.ones(3))
        with pytest.raises(ValueError, match="no such shape"):
            looks(jnp.ones(2))
        assert gc.isenabled() == enabled
    finally:
        gc.enable()
    assert seen == [False, False]


TRANSFORMS = {
    "alone": lambda f: f,
    "jit": jax.jit,
    "vmap": jax.vmap,
    "options": lambda f: jax.jit(f, compiler_options=compiler_options()),
    "closed": lambda f: jax.jit(lambda x: f(jnp.asarray(_X)) + 0 * x),
    "scan": lambda f: lambda x: jax.lax.scan(lambda c, row: (c, f(row)), 0.0, x)[1],
    "linear": lambda f: lambda x: jax.linearize(f, x)[0],
    "lowered": lambda f: lambda x: _lean.lower(x, 3.0).compile()(x, 3.0),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_every_transform_takes_it(name):
    found = TRANSFORMS[name](lambda x: _lean(x, 3.0))(jnp.asarray(_X))
    np.testing.assert_allclose(found, 3 * np.sin(_X) * _X, rtol=1e-12)


def test_derivatives():
    check_grads(lambda x: _lean(x, 3.0), (jnp.asarray(_X),), order=2, rtol=1e-6)


def test_what_the_compiler_leaves_is_given_back_before_the_program_runs(monkeypatch):
    happened = []
    monkeypatch.setattr(_compiler, "release_memory", lambda: happened.append("released"))

    @lean_jit
    def told(x):
        jax.debug.callback(lambda: happened.append("ran"))
        return x + 1

    def ran(x):
        jax.block_until_ready(told(x))
        jax.effects_barrier()
        found, happened[:] = list(happened), []
        return found

    assert ran(jnp.ones(3)) == ["released", "ran"]
    assert ran(jnp.zeros(3)) == ["ran"]
    assert ran(jnp.ones(4)) == ["released", "ran"]


def test_it_is_traced_once_for_all_numbers_and_for_each_static_value():
    traces = []

    def scaled(x, *, power):
        traces.append(power)
        return x**power

    for power in (2, 3, 2):
        for shift in (0.0, 1.0):
            x = jnp.asarray(_X + shift)
            # A program belongs to the function, not to what wraps it.
            found = lean_jit(scaled)(x, power=power)
            np.testing.assert_allclose(found, x**power, rtol=1e-12)
    assert traces == [2, 3]


_TWO_DEVICES = """
import jax
jax.config.update("jax_num_cpu_devices", 2)
import jax.numpy as jnp
import mvedge_jax as mv
here, there = jax.devices()
views = jax.device_put(jnp.zeros((3, 3, 8, 8, 3)), here)
light_field = mv.LightField(views, disparity_range=(-1.0, 1.0))
from mvedge_jax.depth import estimate_depth
model = mv.EdgeDepth.for_light_field(light_field)
for call in (estimate_depth, estimate_depth.lower):
    try:
        call(light_field, jax.device_put(model, there))
    except ValueError as error:
        print(error)
total = mv.lean_jit(lambda a, b: a + b)
print(total(jax.device_put(1.0, there), 2.0))  # what was put nowhere goes along
spread = jax.sharding.NamedSharding(jax.make_mesh((2,), ("x",)), jax.sharding.PartitionSpec("x"))
a = jax.device_put(jnp.ones(2), spread)
print(total(a, jax.device_put(jnp.ones(2), spread)))
"""


def test_arguments_on_different_devices_are_named():
    run = subprocess.run(
        [sys.executable, "-c", _TWO_DEVICES], capture_output=True, text=True, check=True
    )
    *refused, alone, together = run.stdout.splitlines()
    assert refused == 2 * [
        "Arguments of `estimate_depth` are on different devices: `light_field` on cpu:0, "
        "`model` on cpu:1. Put all of them on one, as by `jax.device_put(model, device)`."
    ]
    assert (alone, together) == ("3.0", "[2. 2.]")
