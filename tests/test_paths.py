"""Numbers and static fields of a tree of modules, by path."""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import count_traces
from jaxtyping import Array, Float

from mvedge_jax import EdgeDepth, LightField
from mvedge_jax._params import at_least, number, one_of
from mvedge_jax._paths import describe, described, replaced, value_at
from mvedge_jax.depth import SplattedLabels
from mvedge_jax.diffusion import Multigrid
from mvedge_jax.edges.sides import NoSides


class _Inner(eqx.Module):
    width: Float[Array, ""] = number(2.0, "px")
    least: Float[Array, ""] = number(0.5, "px", threshold=True)
    mode: Literal["a", "b"] = eqx.field(static=True, default="a")

    def __check_init__(self) -> None:
        one_of(self, mode=("a", "b"))


class _Outer(eqx.Module):
    inner: _Inner = eqx.field(default_factory=_Inner)
    other: _Inner | None = None
    taps: Float[Array, " k"] = eqx.field(default_factory=lambda: jnp.asarray([-1.0, 1.0]))
    rounds: int = eqx.field(static=True, default=3)

    def __check_init__(self) -> None:
        at_least(self, rounds=1)


def test_all_numbers_and_static_fields_are_described():
    rows = describe(_Outer())
    paths = ["inner.width", "inner.least", "inner.mode", "taps", "rounds"]
    assert [row.path for row in rows] == paths
    assert [row.unit for row in rows] == ["px", "px", "", "", ""]
    assert [row.path for row in rows if row.threshold] == ["inner.least"]
    assert [row.path for row in rows if row.static] == ["inner.mode", "rounds"]
    assert float(rows[0].value) == 2
    assert (rows[2].value, rows[4].value) == ("a", 3)
    assert all(value_at(_Outer(), row.path) == row.value for row in rows if row.path != "taps")
    assert described(_Outer()) == ["inner.width = 2 px", "inner.least = 0.5 px", "taps = f64[2]"]
    shown = []
    jax.eval_shape(lambda outer: shown.extend(described(outer)), _Outer())
    assert shown[0] == "inner.width = f64[] px"
    # A part that is None is left out, and one that is given is not.
    given = replaced(_Outer(), {"other": _Inner()})
    more = {row.path for row in describe(given)} - {row.path for row in describe(_Outer())}
    assert more == {"other.width", "other.least", "other.mode"}


def test_every_kind_of_field_is_replaced():
    outer = _Outer()
    found = replaced(outer, {"inner.width": 3, "rounds": 5, "inner.mode": "b", "taps": jnp.ones(3)})
    assert float(found.inner.width) == 3
    # As strongly typed as the default, so that no value is another program.
    assert found.inner.width.dtype == outer.inner.width.dtype
    assert not found.inner.width.weak_type
    assert (found.rounds, found.inner.mode) == (5, "b")
    np.testing.assert_array_equal(found.taps, [1, 1, 1])
    assert float(outer.inner.width) == 2
    part = replaced(outer, {"inner": _Inner(width=jnp.asarray(7.0)), "inner.least": 1.0})
    assert (float(part.inner.width), float(part.inner.least)) == (7, 1)


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("iner.width", r"the fields of `_Outer` are \['inner', 'other', 'taps', 'rounds'\]"),
        ("inner.widht", r"the fields of `_Inner` are \['width', 'least', 'mode'\]"),
        ("other.width", "`NoneType` has no fields"),
        ("inner.width.x", "`.*` has no fields"),
        ("", "the fields of `_Outer` are"),
        ("inner.width.", ""),
    ],
)
def test_paths_that_lead_nowhere_are_named_with_what_there_is(path, why):
    for act in (lambda: value_at(_Outer(), path), lambda: replaced(_Outer(), {path: 1.0})):
        with pytest.raises(ValueError, match=f"`{path}` is no path of `_Outer`: {why}"):
            act()


class _Network(eqx.Module):
    """A user's part: its own constructor, layers in a list, functions among its leaves."""

    layers: list
    pair: tuple[_Inner, _Inner]
    scale: Float[Array, ""] = number(1.0)

    def __init__(self, key):
        self.layers = [eqx.nn.Linear(2, 3, key=key), jax.nn.relu]
        self.pair = (_Inner(), _Inner(width=jnp.asarray(4.0)))
        self.scale = jnp.asarray(2.0)

    def __check_init__(self) -> None:
        if isinstance(self.scale, jax.Array) and self.scale.shape:
            raise ValueError(f"`scale` must be one number, got {self.scale.shape}.")


def test_modules_in_lists_and_those_with_a_constructor_of_their_own():
    network = _Network(jax.random.key(0))
    rows = {row.path: row for row in describe(network)}
    assert {"layers[0].weight", "layers[0].bias", "pair[1].width", "scale"} < set(rows)
    assert rows["pair[1].least"].threshold
    assert float(value_at(network, "pair[1].width")) == 4
    found = replaced(network, {"pair[1].width": 5, "layers[0].bias": jnp.ones(3), "scale": 3})
    assert float(found.pair[1].width) == 5
    assert found.pair[0] is network.pair[0]
    np.testing.assert_array_equal(found.layers[0].bias, [1, 1, 1])
    assert found.layers[0].weight is network.layers[0].weight
    assert found.scale.dtype == jnp.float64
    assert jax.tree.structure(found) == jax.tree.structure(network)
    with pytest.raises(ValueError, match=r"`scale` must be one number, got \(3,\)"):
        replaced(network, {"scale": jnp.ones(3)})
    with pytest.raises(ValueError, match=r"the fields of `tuple` are \['\[0\]', '\[1\]'\]"):
        value_at(network, "pair[2].width")


def test_values_out_of_range_are_refused_as_at_the_construction():
    with pytest.raises(ValueError, match="`rounds` must be at least 1, got 0"):
        replaced(_Outer(), {"rounds": 0})
    # Past the annotations, which are checked in tests only.
    wrong: Any = "c"
    with pytest.raises((ValueError, TypeError), match="mode"):
        replaced(_Outer(), {"inner.mode": wrong})


def test_one_trace_serves_every_number_and_derivatives_pass():
    def total(outer):
        return outer.inner.width**2 + outer.taps.sum()

    run, traces = count_traces(total)
    for value in (1.0, 2, jnp.asarray(3.0), np.float64(4.0)):
        run(replaced(_Outer(), {"inner.width": value}))
    assert traces() == 1

    def of_value(value):
        return total(replaced(_Outer(), {"inner.width": value}))

    assert float(jax.jit(jax.grad(of_value))(3.0)) == 6
    np.testing.assert_allclose(jax.vmap(of_value)(jnp.arange(3.0)), [0, 1, 4])


@pytest.fixture(scope="module")
def chain():
    flat = LightField(jnp.full((3, 3, 16, 16, 3), 0.5), disparity_range=(-1.0, 1.0))
    return EdgeDepth.for_light_field(flat)


def test_all_leaves_of_the_chain_are_described_and_have_a_unit_or_are_ratios(chain):
    rows = [row for row in describe(chain) if not row.static]
    assert len(rows) == len(jax.tree.leaves(chain))
    assert len({row.path for row in rows}) == len(rows)
    for row in rows:
        moved = replaced(chain, {row.path: 0.25})
        assert float(value_at(moved, row.path)) == 0.25
    units = {row.path: row.unit for row in rows}
    assert units["smoothness.color"] == "CIELAB"
    assert units["refine.sharpen.slack"] == "px"


def test_parts_of_the_chain_are_replaced_by_name_and_by_path(chain):
    found = chain.replace({"smoothness.color": 0.5}, sides=NoSides(), solver=Multigrid())
    assert float(found.smoothness.color) == 0.5
    assert isinstance(found.sides, NoSides)
    assert isinstance(found.solver, Multigrid)
    splatted = chain.replace(labels=SplattedLabels())
    wide = splatted.replace({"labels.splat.raster.radius": 3})
    assert wide.labels.splat.raster.radius == 3
    with pytest.raises(ValueError, match=r"`side` is no path of `EdgeDepth`: .*'sides'"):
        chain.replace(side=NoSides())


def test_of_a_layer_only_the_arrays_are_described():
    layers = [
        eqx.nn.Linear(2, 3, key=jax.random.key(0)),
        eqx.nn.Conv2d(1, 2, 3, key=jax.random.key(1)),
    ]
    paths = [row.path for layer in layers for row in describe(layer)]
    assert paths == ["weight", "bias"] * 2
