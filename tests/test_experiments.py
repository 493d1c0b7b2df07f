"""What the experiments share: origins of results, the page's tables, the table of edges."""

import json
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import _items, _report, all as page, peer_maps, table_edges
from mvedge_jax.datasets import write_pfm
from mvedge_jax.lightfield import GroundTruth


def test_results_tell_commit_and_command_and_are_shown_on_the_page(tmp_path, monkeypatch):
    script = Path(_report.__file__).parent / "table_edges.py"
    monkeypatch.setattr(sys, "argv", [str(script), "--scenes", "edges", "--out", "a folder"])
    rows = [{"scene": "edges", "MSE*100": 0.5}]
    _report.write_json(tmp_path / "found.json", {"rows": rows})
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["commit"]
    words = "python experiments/table_edges.py --scenes edges --out 'a folder'"
    assert found["command"] == words
    assert list(page._tables(found, "found")) == [("found: rows", rows)]


def test_every_item_has_its_script_and_a_name_of_its_own():
    folder = Path(_items.__file__).parent
    assert all((folder / item.script).is_file() for item in _items.ITEMS)
    assert len({item.name for item in _items.ITEMS}) == len(_items.ITEMS)


def test_the_table_of_edges_ends_with_the_mean_and_the_worst_scene():
    columns = table_edges.COLUMNS
    rows = [
        {"scene": scene, "method": method, **dict.fromkeys(columns, value)}
        for scene, value in (("edges", 1.0), ("demo", 3.0))
        for method in ("edges", "full")
    ]
    found = table_edges.summary(rows)
    assert [(row["scene"], row["method"]) for row in found] == [
        (what, method) for what in ("mean", "worst") for method in ("edges", "full")
    ]
    assert [row["MSE*100"] for row in found] == [2.0, 2.0, 3.0, 3.0]
    assert [method.name for method in table_edges.METHODS] == [
        "thesis",
        "edges",
        "edges without transmittance",
        "edges without sides",
        "full without edges",
        "full",
    ]


def test_scripts_share_compiled_programs_but_benchmarks_compile_their_own(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    items = {item.name: item for item in _items.ITEMS}
    shared = page._environment(items["table_6_2"], tmp_path)
    assert shared["JAX_COMPILATION_CACHE_DIR"] == str(tmp_path)
    alone = page._environment(items["benchmark_depth"], tmp_path)
    assert "JAX_COMPILATION_CACHE_DIR" not in alone


def test_every_script_of_a_table_leaves_its_rows_as_json():
    folder = Path(_items.__file__).parent
    texts = {item.script: (folder / item.script).read_text("utf-8") for item in _items.ITEMS}
    assert [script for script, text in texts.items() if "write_json(" not in text] == []


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
