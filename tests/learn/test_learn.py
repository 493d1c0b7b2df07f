"""Learning: what is chosen moves and nothing else, runs go on where they stopped, mistakes."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from jaxtyping import Array

from mvedge_jax._params import number
from mvedge_jax.learn import RobustLoss, chosen, learn, of_one_range, robust_loss
from mvedge_jax.lightfield import GroundTruth, LightField

KEY = jax.random.key(3)
ADAM = optax.adam(optax.cosine_decay_schedule(0.1, 40))
SIZE = (8, 9)


class Map(NamedTuple):
    disparity: Array


class Inner(eqx.Module):
    taps: Array
    tilt: Array = number(0.5, "px")


class Plane(eqx.Module):
    """A map made of numbers: no chain has to be compiled."""

    inner: Inner
    level: Array = number(1.5, "px")
    other: Array = number(2.0, "px")
    edge: Array = number(0.1, "px", threshold=True)
    none: Array = number(0.0, "px")
    mode: str = eqx.field(static=True, default="plain")

    def __call__(self, light_field: LightField, *, key: Any = None) -> Map:
        del key
        assert light_field.truth is None
        across = jnp.linspace(-1.0, 1.0, SIZE[1])[None] * jnp.ones((SIZE[0], 1))
        kept = jnp.where(self.edge > 0, self.other + self.none, 0.0)
        level = 2 * self.level * light_field.views.mean()
        return Map(level + across * self.inner.tilt * kept + self.inner.taps.sum())


@pytest.fixture
def model():
    return Plane(Inner(jnp.zeros(3)))


def scene(level, tilt=0.6, name="scene"):
    truth = level + tilt * jnp.linspace(-1.0, 1.0, SIZE[1])[None] * jnp.ones((SIZE[0], 1))
    views = jnp.full((3, 3, *SIZE, 3), min(max(0.5 * level, 0.1), 1.0))
    valid = jnp.ones(SIZE, bool).at[0, 0].set(False)
    return LightField(views, truth=GroundTruth(truth, valid), name=name)


@pytest.fixture
def scenes():
    return [scene(0.3 + 0.1 * k, name=f"scene {k}") for k in range(5)]


def run(model, what, scenes, **options):
    return learn(model, what, scenes, **({"optimizer": ADAM, "key": KEY, "steps": 40} | options))


def test_the_loss_falls_and_what_is_not_chosen_stays(model, scenes):
    found = run(model, ["level", "inner"], scenes, validation=scenes[:3])
    assert found.losses[-5:].mean() < 0.7 * found.losses[:5].mean()
    assert found.validation[-1][1] < 0.7 * found.validation[0][1]
    assert [step for step, _ in found.validation] == [0, 10, 20, 30, 40]
    assert set(found.values) == {"level", "inner.tilt", "inner.taps"}
    before, after = model, found.model
    assert float(after.level) != float(before.level)
    assert float(after.level) == pytest.approx(float(found.values["level"]))
    for name in ("other", "edge", "none"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    assert found.factors()["level"] == pytest.approx(float(after.level) / 1.5)
    assert "inner.taps" not in found.factors()
    assert found.best_step > 0


def test_positive_numbers_stay_so_and_arrays_may_change_sign(model):
    found = run(model, ["level", "inner.taps"], [scene(-9.0)], batch=1, optimizer=optax.sgd(0.3))
    assert 0 < float(found.model.level) < 1
    assert float(found.model.inner.taps.min()) < -0.01


def test_a_stopped_run_goes_on_as_if_it_had_not_been(model, scenes, tmp_path):
    options = {"validation": scenes[:2], "steps": 25, "check_every": 5, "batch": 3}
    whole = run(model, ["level", "inner"], scenes, **options)

    class Stopped(Exception): ...

    def stop(now):
        if now.step == 13:
            raise Stopped

    kept = {**options, "checkpoint": tmp_path / "run"}
    with pytest.raises(Stopped):
        run(model, ["level", "inner"], scenes, progress=stop, **kept)
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["state.eqx"]
    steps = []
    again = run(
        model, ["level", "inner"], scenes, progress=lambda now: steps.append(now.step), **kept
    )
    assert steps[0] == 11
    np.testing.assert_array_equal(again.losses, whole.losses)
    assert again.validation == whole.validation
    for path, value in whole.values.items():
        np.testing.assert_array_equal(again.values[path], value)
    # A finished run is read, not repeated.
    done = run(model, ["level", "inner"], scenes, **kept)
    np.testing.assert_array_equal(done.losses, whole.losses)


def test_a_checkpoint_of_another_run_or_a_damaged_one_is_refused(model, scenes, tmp_path):
    run(model, ["level"], scenes, checkpoint=tmp_path, steps=2)
    with pytest.raises(ValueError, match=r"is of a run with `steps` = 2, this one has 3; choose"):
        run(model, ["level"], scenes, checkpoint=tmp_path, steps=3)
    run(model, ["level"], scenes, checkpoint=tmp_path, steps=3, resume=False)
    path = tmp_path / "state.eqx"
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"nonsense", b""):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="does not hold a whole state of learning"):
            run(model, ["level"], scenes, checkpoint=tmp_path, steps=3)


def test_learning_stops_where_validation_gets_no_better(model, scenes):
    worse = [scene(-3.0, -4.0)]
    found = run(model, ["level", "inner.tilt"], scenes, validation=worse, patience=2, check_every=3)
    assert len(found.losses) < 40
    assert len(found.losses) - found.best_step == 6
    if found.best_step == 0:
        np.testing.assert_allclose(found.model.level, model.level, rtol=1e-6)


def test_a_prior_keeps_numbers_near_the_start(model, scenes):
    free, held = (
        run(model, ["level"], scenes, prior=p, optimizer=optax.sgd(0.05)) for p in (0.0, 9.0)
    )
    assert abs(np.log(held.factors()["level"])) < 0.6 * abs(np.log(free.factors()["level"]))


def test_a_scene_is_shortened_to_the_limit(model, scenes):
    step = {"optimizer": optax.sgd(1.0), "steps": 1}
    found = run(model, ["level"], scenes, limit=1e-3, batch=2, **step)
    assert abs(np.log(found.factors()["level"])) == pytest.approx(1e-3, rel=0.01)


def test_a_loss_that_is_none_names_the_step_and_the_scene(model, scenes):
    scenes[2] = scene(0.5, name="the bad one")
    bad = eqx.tree_at(lambda s: s.truth.disparity, scenes[2], scenes[2].truth.disparity * jnp.inf)
    scenes[2] = bad
    with pytest.raises(FloatingPointError, match=r"step \d+: the loss of `scenes\[2\]` \(the bad"):
        run(model, ["level"], scenes)
    with pytest.raises(FloatingPointError, match=r"loss of validation scene 0 \(the bad one\) is"):
        run(model, ["level"], scenes[:2], validation=[bad])

    def root(result, light_field):
        del light_field
        return jnp.sqrt(result.disparity.sum() * 0)

    with pytest.raises(FloatingPointError, match=r"step 1: the gradient by `level` is not finite"):
        run(model, ["level"], scenes[:2], loss=root, batch=1)
    with pytest.raises(FloatingPointError, match=r"by `level` and 1 more is not finite"):
        run(model, ["level", "other"], scenes[:2], loss=root, batch=1)


def test_a_number_without_a_derivative_is_named_and_not_those_beside_it(model, scenes):
    class Rooted(Plane):
        def __call__(self, light_field: LightField, *, key: Any = None) -> Map:
            return Map(super().__call__(light_field, key=key).disparity + jnp.sqrt(0 * self.other))

    with pytest.raises(FloatingPointError, match=r"step 1: the gradient by `other` is not finite"):
        run(Rooted(model.inner), ["level", "other"], scenes)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (["levle"], "`levle` is no path of `Plane`"),
        (["mode"], "`mode` holds 'plain'; only numbers and arrays can be learned"),
        (["edge"], "`edge` is a threshold: its derivative is 0"),
        (["none"], "`none` must be positive to be learned, got 0"),
        ([], r"`what` must choose a number at least, got \[\]"),
    ],
)
def test_what_cannot_be_learned_is_told(model, what, message):
    with pytest.raises(ValueError, match=message):
        chosen(model, what)


def test_parts_and_functions_leave_out_what_has_no_derivative(model):
    found = chosen(model, lambda path: True)
    assert found.paths == ("inner.taps", "inner.tilt", "level", "other")
    assert found.logs == {"inner.tilt", "level", "other"}
    assert chosen(model, lambda path: "inner" in path).paths == ("inner.taps", "inner.tilt")
    with pytest.raises(ValueError, match="got a function that chooses none"):
        chosen(model, lambda path: path == "edge")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 0}, "`steps` must be at least 1, got 0"),
        ({"batch": 6}, "`batch` must be at most the number of scenes, 5, got 6"),
        ({"prior": -1.0}, "`prior` must be finite and not negative"),
        ({"validation": []}, "`validation` must have one scene at least, got none"),
    ],
)
def test_options_out_of_range_are_told(model, scenes, options, message):
    with pytest.raises(ValueError, match=message):
        run(model, ["level"], scenes, **options)


def test_scenes_of_another_kind_are_told(model, scenes):
    wide = LightField(jnp.full((5, 5, *SIZE, 3), 0.5), truth=scenes[0].truth, name="wide")
    with pytest.raises(ValueError, match=r"`scenes\[5\]` \(wide\) must be like the first scene"):
        run(model, ["level"], [*scenes, wide])
    with pytest.raises(ValueError, match="has no ground truth to learn from"):
        run(model, ["level"], [scenes[0].without_truth()], batch=1)


def test_scenes_get_the_widest_range():
    truth = GroundTruth(jnp.zeros(SIZE), jnp.ones(SIZE, bool))
    views = jnp.full((3, 3, *SIZE, 3), 0.5)
    ranges = ((-1.0, 0.5), (-0.25, 2.0))
    fields = [LightField(views, disparity_range=r, truth=truth, name=str(r)) for r in ranges]
    for field, name in zip(of_one_range(fields), ranges, strict=True):
        assert np.asarray(field.disparity_range).tolist() == [-1.0, 2.0]
        assert field.name == str(name)


def test_the_robust_loss_ignores_what_is_not_known(scenes):
    field = scenes[0]
    error = jnp.full(SIZE, 0.03).at[0, 0].set(jnp.nan)
    found = robust_loss(field.truth.disparity + error, field, scales=(0.03,))
    assert float(found) == pytest.approx(np.log(2))
    both = RobustLoss((0.03, 0.06))(Map(field.truth.disparity + error), field)
    assert float(both) == pytest.approx((np.log(2) + np.log(1.25)) / 2)
    with pytest.raises(ValueError, match="`scales` must be positive, one at least"):
        RobustLoss(())
