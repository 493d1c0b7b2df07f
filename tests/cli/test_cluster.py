"""`mvedge batch` on a Dask cluster: failures, retries, resumption; and the script for SLURM."""

import ast
import csv
import functools
import json
import os
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from datasets.layouts import write_hci

from mvedge_jax._settings import of_preset
from mvedge_jax.cli import _batch_scene
from mvedge_jax.cli._cluster import connected, outcomes
from mvedge_jax.cli._model import ModelOptions
from mvedge_jax.cli._output import write_json
from mvedge_jax.learn import Learned

distributed = pytest.importorskip("distributed")
NAMES = ("broken", "corrupt", "fine", "flaky", "other")


@pytest.fixture
def scenes(tmp_path):
    found = {name: write_hci(tmp_path / name, _views(name)) for name in NAMES}
    (found["corrupt"] / "input_Cam004.png").write_bytes(b"not a picture")
    return found


def _views(name):
    return np.full((3, 3, 10 if name == "other" else 8, 8, 3), 128, np.uint8)


@pytest.fixture
def cluster():
    """Two workers that are threads of this process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def estimated(monkeypatch):
    """How often each light field was estimated, in place of the chain."""
    calls = Counter()

    def estimate(light_field, name):
        calls[name] += 1
        if name == "flaky" and calls[name] < 3:
            raise OSError("the network is gone")
        if name == "broken":
            raise RuntimeError("what went wrong")
        result = SimpleNamespace(problems=list)
        return result, of_preset("full"), {"compilation": 0.0, "estimation": 0.1}

    def write(folder, light_field, truth, model, result, told):
        (folder / "height").write_text(str(light_field.views.shape[2]))
        write_json(folder / "report.json", told | {"converged": True, "scores": {}})

    monkeypatch.setattr(_batch_scene, "estimate_of", functools.cache(lambda *kind: estimate))
    monkeypatch.setattr(_batch_scene, "write_depth", write)
    return calls


def test_a_failure_stops_no_other_and_what_may_pass_is_tried_again(
    scenes, cluster, estimated, tmp_path, mvedge
):
    out = tmp_path / "out"
    words = ["batch", *scenes.values(), out, "--scheduler", cluster, "--range", -1, 1]
    said = mvedge(*words, code=1)
    with (out / "summary.csv").open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert list(rows) == list(NAMES)
    states = {name: row["state"] for name, row in rows.items()}
    failed = {"broken": "failed", "corrupt": "failed"}
    assert states == {**dict.fromkeys(NAMES, "done"), **failed}
    assert "input_Cam004.png" in rows["corrupt"]["reason"]
    assert rows["broken"]["reason"] == "RuntimeError: what went wrong"
    assert estimated == {"broken": 3, "fine": 1, "flaky": 3, "other": 1}
    assert rows["flaky"]["attempt"] == "3"
    assert f"flaky: done by {rows['flaky']['worker']}, attempt 3\n" in said.out
    assert "3 of 5 light fields done" in said.out
    assert "broken failed: RuntimeError: what went wrong" in said.err
    assert (out / "other" / "height").read_text() == "10"

    mvedge(*words, code=1)
    again = json.loads((out / "summary.json").read_text())
    assert [row["state"] for row in again.values()] == ["failed", "failed", *3 * ["there already"]]
    assert estimated == {"broken": 6, "fine": 1, "flaky": 3, "other": 1}


def test_a_result_whose_worker_died_before_it_told_is_not_made_again(scenes, estimated, tmp_path):
    known = {"views": None, "scale": 1.0, "range": (-1.0, 1.0), "all_views": False, "seed": 0}
    asked = _batch_scene.Options(
        **known, video=False, again=False, model=_batch_scene.ModelOptions()
    )
    kind, ends = _batch_scene.survey(scenes["fine"], asked, {})
    arguments = ("fine", scenes["fine"], tmp_path / "out", kind, ends)
    first = _batch_scene.make(*arguments, asked)
    assert _batch_scene.make(*arguments, asked) == first
    assert estimated["fine"] == 1
    _batch_scene.make(*arguments, asked._replace(again=True))
    assert estimated["fine"] == 2


def test_workers_take_a_seed_each(cluster, tmp_path, mvedge, monkeypatch):
    calls = []

    def learn(model, what, fields, *, checkpoint, **options):
        calls.append(checkpoint)
        if len(calls) == 1:
            raise OSError("the network is gone")
        return Learned(model, model, {}, np.ones(1), [], 1)

    monkeypatch.setattr("mvedge_jax.cli._learn_seed.learn_from", learn)
    out = tmp_path / "out"
    words = ["learn", out, "--random", 2, "--size", 16, "--views", 3, "--preset", "edges"]
    mvedge(*words, "--seeds", 0, 1, "--scheduler", cluster)
    rows = json.loads((out / "summary.json").read_text())
    assert [row["state"] for row in rows.values()] == ["done", "done"]
    assert sorted(row["attempt"] for row in rows.values()) == [1, 2]
    assert len(calls) == 3
    assert set(calls) == {tmp_path / "out.checkpoint" / name for name in rows}


@pytest.mark.parametrize("command", ["batch", "learn"])
def test_workers_are_told_paths_that_hold_in_every_folder(
    command, scenes, cluster, tmp_path, mvedge, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    write_json(tmp_path / "learned.json", {"preset": "full", "factors": {}})
    told = []

    def outcomes(client, function, calls):
        told.extend(calls.values())
        raise ValueError("seen")

    def paths(tree):
        if isinstance(tree, Path):
            return [tree]
        if isinstance(tree, ModelOptions):
            return [tree.learned] if tree.learned else []
        return [path for part in tree for path in paths(part)] if isinstance(tree, tuple) else []

    monkeypatch.setattr(f"mvedge_jax.cli._{command}.outcomes", outcomes)
    words = [command, "fine", "out", "--model", "learned.json", "--scheduler", cluster]
    assert "seen" in mvedge(*words, code=2).err
    found = paths(tuple(told))
    assert tmp_path / "fine" in found
    assert tmp_path / "learned.json" in found
    assert all(path.is_absolute() for path in found)


def test_the_script_for_slurm_runs_the_same_command(scenes, tmp_path, mvedge, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--views", "3", "--range", "-1", "1.5", "--again", "--set", "refine.solves=1"]
    script = mvedge("batch", "fine", "out", *words, "--slurm").out
    assert "cluster.scheduler_address" in script
    command = next(
        ast.literal_eval(line.value)
        for line in ast.parse(script).body
        if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "COMMAND"
    )
    paths = ["batch", str(tmp_path / "fine"), str(tmp_path / "out")]
    words[words.index("1.5") - 1] = "-1.0"
    model = ["--preset", "full", *words[-2:], "--seed", "0"]
    assert command == [*paths, *words[:-2], *model]
    assert not (tmp_path / "out").exists()


def test_a_scheduler_without_workers_is_told(capsys):
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as empty,
        connected(0, empty.scheduler_address),
    ):
        assert "has no workers yet; waiting for the first" in capsys.readouterr().err


def test_an_address_that_is_none_names_the_option():
    wrong = r"no Dask scheduler answers at nowhere \(--scheduler; expected .* tcp://host:8786\)"
    with pytest.raises(ValueError, match=wrong), connected(0, "nowhere"):
        pass


@pytest.mark.slow
def test_a_call_whose_worker_dies_runs_again(tmp_path):
    marks = tmp_path

    def die_once(name):
        first = not (marks / name).exists()
        (marks / name).touch()
        if first and name == "b":
            time.sleep(0.5)
            os._exit(1)
        return name.upper()

    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster.scheduler_address) as client,
    ):
        found = {o.name: o for o in outcomes(client, die_once, {name: (name,) for name in "abcd"})}
    assert {name: o.value for name, o in found.items()} == {name: name.upper() for name in "abcd"}
    assert len(found["b"].workers) == 2
