"""Sweeps: settings, scores, journals, pruning; against single calls."""

import os
import signal
import subprocess
import sys
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optuna
import pytest

from mvedge_jax._settings import of_preset
from mvedge_jax.datasets import synthetic, write_hci
from mvedge_jax.depth import DepthResult, EdgeDepth
from mvedge_jax.lightfield import LightField
from mvedge_jax.metrics import depth_scores
from mvedge_jax.sweep import Interval, Space, _evaluate, evaluate, plot_sweep, sweep

optuna.logging.set_verbosity(optuna.logging.WARNING)

SPACE = Space({"refine.precision": Interval(0.002, 0.02), "dense.trust": Interval(0.7, 2.8)})


@pytest.fixture
def scored(monkeypatch):
    """Puts a function of scene, settings and choices in place of the chain."""

    def put(function):
        def score(scene, rows, *, choices, **_):
            return function(scene, rows, choices)

        monkeypatch.setattr("mvedge_jax.sweep._sweep.evaluate", score)

    return put


@pytest.fixture
def bowl(scored):
    """Scores with a minimum that is known."""
    calls = []

    def score(scene, rows, choices):
        calls.append((scene, len(rows), dict(choices)))
        target = np.log([0.006, 1.2])[: rows.shape[1]]
        away = ((np.log(rows) - target) ** 2).sum(-1)
        return away + choices.get("refine.solves", 0) + len(str(scene))

    scored(score)
    return calls


BELOW = Interval(-1.0, 1.0, log=False)


# More of them, of the command line, are in tests/hostile/words.py.
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Space({}, {"refine.solves": ()}), "at least one value"),
        (lambda: sweep([], SPACE), "`scenes` must be at least 1, got 0"),
        (lambda: sweep(["a"], SPACE, threads=0), "`threads` must be at least 1, got 0"),
        (
            lambda: sweep(["a"], SPACE, start={"refine.solves": "two"}),
            "`refine.solves` must be a whole number, got 'two'",
        ),
        (
            lambda: sweep(["a"], Space({"refine.precision": BELOW})),
            "`refine.precision` must be finite and not negative",
        ),
        (
            lambda: sweep(["a"], Space({}, {"refine": (1,)})),
            "`refine` is a part, whose numbers and static fields are",
        ),
        (
            lambda: sweep(["a"], Space({}, {"solver.by_residual": (1,)})),
            "`solver.by_residual` must be true or false, got 1",
        ),
    ],
)
def test_mistakes_are_told(make, message, bowl):
    with pytest.raises(ValueError, match=message):
        make()
    assert not bowl


def test_a_preset_and_what_is_held_reach_every_scene(monkeypatch):
    calls = []

    def score(scene, rows, *, names, choices, preset, objective, batch):
        calls.append((preset, choices))
        return rows[:, 0]

    monkeypatch.setattr("mvedge_jax.sweep._sweep.evaluate", score)
    space = Space({"labels.weight.gain": Interval(1.0, 10.0)}, {"refine.solves": (1,)})
    start = {"smoothness.color": 0.5, "labels.weight.gain": 2.0}
    found = sweep(["a"], space, preset="edges", start=start, trials=4)
    assert found.rows[0]["labels.weight.gain"] == pytest.approx(2.0)
    assert {preset for preset, _ in calls} == {"edges"}
    assert all(choices == {**start, "refine.solves": 1} for _, choices in calls)
    assert found.choices == {**start, "refine.solves": 1, "labels.weight.gain": found.value}


def test_a_minimum_is_found_and_the_defaults_come_first(bowl):
    seen = []
    found = sweep(["a", "bc"], SPACE, trials=60, progress=lambda *now: seen.append(now))
    assert found.rows[0]["refine.precision"] == pytest.approx(0.005)
    assert found.value < 1.5 + 0.05
    assert found.choices["refine.precision"] == pytest.approx(0.006, rel=0.3)
    assert len(found.rows) == 60
    assert [n for n, _ in seen] == [16, 32, 48, 60]
    row = found.rows[7]
    assert row["mean"] == pytest.approx((row["a"] + row["bc"]) / 2)


def test_a_bound_that_is_the_default_holds_it(bowl):
    """Though its nearest number of single precision may lie beyond."""
    space = Space({"refine.precision": Interval(0.005, 0.05), "dense.trust": Interval(0.7, 1.4)})
    first = sweep(["a"], space, trials=1).rows[0]
    assert first["refine.precision"] == pytest.approx(0.005, rel=1e-6)
    assert first["dense.trust"] == pytest.approx(1.4, rel=1e-6)
    beyond = Space({"refine.precision": Interval(0.0051, 0.05)})
    assert beyond.start(of_preset("full")) is None


def test_scenes_of_one_name_keep_their_scores(bowl):
    found = sweep(["a", "b/a", "mean"], SPACE, trials=2)
    row = found.rows[0]
    scores = [row["a"], row["a (2)"], row["mean (2)"]]
    assert scores[1] - scores[0] == pytest.approx(2)
    assert row["mean"] == pytest.approx(np.mean(scores))


def test_choices_are_grouped(bowl):
    space = Space(SPACE.numbers, {"refine.solves": (2, 1)})
    found = sweep(["a"], space, trials=32, batch=4)
    assert found.choices["refine.solves"] == 1
    assert all(count <= 4 for _, count, _ in bowl)
    # One wave of 16 in two groups: no more calls than full batches and one rest each.
    assert len(bowl) <= 2 * (4 + 2)


def test_threads_run_side_by_side_but_what_may_compile_runs_alone(scored):
    running, most, beside, seen = [], [], [], set()

    def score(scene, rows, choices):
        running.append(scene)
        most.append(len(running))
        program = scene, choices["refine.solves"]
        first = program not in seen
        seen.add(program)
        time.sleep(0.05)
        if first:
            beside.append(len(running) - 1)
        running.remove(scene)
        return rows[:, 0] * choices["refine.solves"] + len(scene)

    scored(score)
    space = Space({"dense.trust": Interval(0.7, 2.8)}, {"refine.solves": (1, 2)})
    options: Any = {"trials": 24, "batch": 2, "wave": 24}
    found = sweep(["a", "bc"], space, threads=2, **options)
    assert beside == [0, 0, 0, 0]
    assert max(most) == 2
    most.clear()
    assert sweep(["a", "bc"], space, threads=1, **options).rows == found.rows
    assert max(most) == 1


def test_a_mistake_in_a_thread_is_the_sweeps(scored):
    def score(scene, rows, choices):
        if len(rows) < 4:
            raise ValueError("what went wrong")
        return rows[:, 0]

    scored(score)
    with pytest.raises(ValueError, match="what went wrong"):
        sweep(["a"], SPACE, trials=18, batch=4, wave=18)


def test_hopeless_settings_are_given_up(bowl):
    pruner = optuna.pruners.MedianPruner(n_startup_trials=8)
    found = sweep(["a", "bc"], SPACE, trials=48, pruner=pruner)
    given_up = [row for row in found.rows if row["state"] == "pruned"]
    assert given_up
    assert all(row["bc"] is None for row in given_up)
    assert {row["state"] for row in found.rows} == {"pruned", "complete"}


def test_a_journal_is_gone_on_from(bowl, tmp_path):
    journal = tmp_path / "runs" / "journal.log"
    first = sweep(["a"], SPACE, trials=20, journal=journal)
    more = sweep(["a"], SPACE, trials=30, journal=journal)
    assert more.rows[:20] == first.rows
    assert len(more.rows) == 30
    with pytest.raises(ValueError, match="a sweep with scenes"):
        sweep(["b"], SPACE, trials=40, journal=journal)
    with pytest.raises(ValueError, match="a sweep with space"):
        sweep(["a"], Space({"dense.trust": Interval(0.7, 2.8)}), trials=40, journal=journal)


_KILLED = """
import sys, time
from mvedge_jax.sweep import Interval, Space, sweep
import mvedge_jax.sweep._sweep as module
def slow(scene, rows, **options):
    if scene == "second":
        print("started", flush=True)
        time.sleep(60)
    return rows[:, 0]
module.evaluate = slow
space = Space({"refine.precision": Interval(0.002, 0.02), "dense.trust": Interval(0.7, 2.8)})
sweep(["first", "second"], space, trials=32, journal=sys.argv[1])
"""


def test_nothing_is_lost_when_a_sweep_is_killed(bowl, tmp_path):
    journal = tmp_path / "journal.log"
    process = subprocess.Popen(
        [sys.executable, "-c", _KILLED, str(journal)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "started"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    found = sweep(["first", "second"], SPACE, trials=32, journal=journal)
    assert len(found.rows) == 32
    asked = [t for t in found.study.trials if t.number in found.study.user_attrs["lost"]]
    again = found.rows[: len(asked)]
    assert len(asked) == 16
    for one, other in zip(asked, again, strict=True):
        assert one.params == {n: other[n] for n in SPACE.names}


def test_scores_that_are_not_finite_fail(scored):
    scored(lambda scene, rows, choices: np.where(rows[:, 0] > 0.006, np.nan, rows[:, 0]))
    found = sweep(["a"], SPACE, trials=20)
    assert {row["state"] for row in found.rows} == {"complete", "fail"}
    assert len(found.rows) == 20
    scored(lambda scene, rows, choices: np.full(len(rows), np.nan))
    with pytest.raises(ValueError, match="no setting had a finite score"):
        sweep(["a"], SPACE, trials=4)


def test_the_figure_shows_every_number(bowl):
    found = sweep(
        ["a"], Space(SPACE.numbers, {"measurement.views": ("crosshair", "all")}), trials=24
    )
    labels = [axes.get_xlabel() for axes in plot_sweep(found).axes]
    assert labels[:2] == ["setting", "importance"]
    assert set(labels[2:]) == {"refine.precision", "dense.trust", "measurement.views"}


@pytest.mark.slow
def test_scores_of_a_batch_are_those_of_single_calls():
    light_field = synthetic.render(
        synthetic.scene("demo"), shape=(5, 5, 40, 48), samples=1, key=jax.random.key(0)
    )
    rows = np.array([[0.005, 1.4], [0.02, 0.5], [0.003, 3.0]])
    names = ("refine.precision", "dense.trust")
    options: Any = {"names": names, "choices": {"refine.solves": 1}, "preset": "full"}
    found = evaluate(light_field, rows, **options, objective="mae", batch=2)
    blind, truth = light_field.without_truth(), light_field.truth
    assert truth is not None
    for row, score in zip(rows, found, strict=True):
        setting = {"refine.solves": 1, **dict(zip(names, map(float, row), strict=True))}
        depth = EdgeDepth.for_light_field(blind, choices=setting)(blind).disparity
        expected = depth_scores(depth, truth.disparity, mask=truth.valid).mae
        np.testing.assert_allclose(score, expected, rtol=1e-3)


def test_scenes_of_one_kind_share_a_program_whatever_their_names(monkeypatch):
    traces = []

    def width(result, light_field):
        traces.append(light_field.name)
        return result.disparity

    def mean(field, *_, **__):
        unread: Any = [None] * 5
        return DepthResult(field.views.mean(), *unread)

    monkeypatch.setattr(_evaluate, "estimate_depth", mean)
    views = jnp.full((3, 3, 8, 8, 3), 0.5)
    options: Any = {"names": ("dense.trust",), "choices": {}, "preset": "full", "batch": 2}
    options["objective"] = width
    for name, value in (("one", 0.5), ("two", 0.25)):
        field = LightField(value * views, disparity_range=(-1.0, 1.0), name=name)
        found = evaluate(field, np.array([[1.0]]), **options)
        np.testing.assert_allclose(found, [0.5 * value])
    assert traces == [""]
    with pytest.raises(ValueError, match="scene two has no ground truth"):
        evaluate(field, np.array([[1.0]]), **{**options, "objective": "mae"})


@pytest.mark.slow
def test_a_cluster_gives_the_result_of_one_process(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("JAX_ENABLE_X64", "1")  # the workers' number format, as is that of tests
    light_field = synthetic.render(
        synthetic.scene("demo"), shape=(3, 3, 32, 40), samples=1, key=jax.random.key(0)
    )
    write_hci(light_field, tmp_path / "scene")
    options = {"trials": 8, "batch": 2, "wave": 4, "objective": "mae"}
    scenes = [tmp_path / "scene"]
    alone = sweep(scenes, SPACE, **options)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True
        ) as cluster,
        distributed.Client(cluster.scheduler_address) as client,
    ):
        shared = sweep(scenes, SPACE, submit=client.submit, **options)
    for one, other in zip(alone.rows, shared.rows, strict=True):
        assert [one[n] for n in SPACE.names] == [other[n] for n in SPACE.names]
        assert one["mean"] == pytest.approx(other["mean"], rel=1e-9)
    assert alone.study.best_trial.number == shared.study.best_trial.number
