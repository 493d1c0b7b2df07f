"""What the experiments share: origins of results, the page's tables, the table of edges."""

import json
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import _items, _photographs, _report, all as page, peer_maps
from mvedge_jax.datasets import write_pfm
from mvedge_jax.lightfield import GroundTruth


def test_results_tell_commit_and_command_without_folders_of_this_machine(tmp_path, monkeypatch):
    script = str(_report.ROOT / "experiments" / "table_edges.py")
    data = str(_report.ROOT.parent / "shared" / "data")
    monkeypatch.setattr(sys, "argv", [script, "--data", data, "--out", "a folder"])
    rows = [{"scene": "edges", "MSE*100": 0.5}]
    _report.write_json(tmp_path / "found.json", {"rows": rows})
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["commit"]
    # No figure depends on where the results went.
    assert found["command"] == "python experiments/table_edges.py --data ../shared/data"
    # They are shown on the page.
    assert list(page._tables(found, "found")) == [("found: rows", rows)]


def test_every_item_has_a_name_of_its_own_and_a_script_that_leaves_its_rows_as_json():
    folder = Path(_items.__file__).parent
    assert len({item.name for item in _items.ITEMS}) == len(_items.ITEMS)
    # Long ones start first; two cores have 100 minutes for all of them.
    assert sum(item.seconds for item in _items.ITEMS) < 100 * 60 * 2
    texts = {item.script: (folder / item.script).read_text("utf-8") for item in _items.ITEMS}
    assert [script for script, text in texts.items() if "write_json(" not in text] == []


def test_a_script_that_runs_out_of_time_ends_with_all_that_it_has_started(tmp_path, monkeypatch):
    script = """
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
print(child.pid, flush=True)
time.sleep(600)
"""
    (tmp_path / "hangs.py").write_text(script)
    monkeypatch.setattr(page, "HERE", tmp_path)
    item = _items.Item("hangs", "hangs.py", "", "", "nothing", 1)
    row = page._run(item, "quick", tmp_path / "out", "a commit", 1.5, again=True)
    assert (row["state"], row["why"]) == ("failed", "stopped after 2 s")
    status = Path(f"/proc/{int((tmp_path / 'out' / 'log.txt').read_text())}/status")
    deadline = time.monotonic() + 10
    while status.exists() and "(zombie)" not in status.read_text() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not status.exists() or "(zombie)" in status.read_text()


def test_a_published_map_is_scored_on_the_pixels_that_it_has(tmp_path):
    truth = GroundTruth(jnp.zeros((40, 40), jnp.float32), jnp.ones((40, 40), bool))
    place = tmp_path / "peer_results" / "spo"
    place.mkdir(parents=True)
    write_pfm(place / "edges.pfm", np.full((36, 36), 0.05, np.float32))
    (row,) = peer_maps.peer_rows(tmp_path, "edges", truth)
    assert (row["method"], row["margin px"]) == ("SPO", 2)
    assert row["source"] == "published map, peer_results/spo/edges.pfm"
    np.testing.assert_allclose(row["MSE*100"], 0.25, rtol=1e-5)
    assert (row["BP(.03)"], row["BP(.07)"]) == (100, 0)
    assert list(peer_maps.peer_rows(tmp_path, "demo", truth)) == []
    write_pfm(place / "edges.pfm", np.zeros((36, 30), np.float32))
    with pytest.raises(ValueError, match=r"edges.pfm has \(36, 30\) px; expected the views' \(40"):
        list(peer_maps.peer_rows(tmp_path, "edges", truth))


def test_the_thesis_errors_have_unknown_pixels_at_the_mean_and_forget_the_scale():
    truth = jnp.asarray(np.random.default_rng(0).uniform(1, 3, (20, 30)))
    found = _photographs.as_printed((0.5 * truth).at[3, 4].set(0), truth)
    mean = float(truth.mean())
    assert float(found.mse) == pytest.approx(100 * (float(truth[3, 4]) - mean) ** 2 / 600)
    assert float(found.q25) == pytest.approx(0, abs=1e-5)
