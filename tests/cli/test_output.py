"""Nothing of a user's is ever deleted: what --overwrite replaces, what it refuses, and locks."""

import errno
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from datasets.layouts import random_views, write_hci

from mvedge_jax.cli import _eval, _main, _output
from mvedge_jax.cli._output import MARKER, output_folder, write_json
from mvedge_jax.datasets import write_pfm


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch):
    monkeypatch.setenv("MVEDGE_CACHE", "off")


@pytest.fixture
def user(tmp_path):
    """A user's folder: a scene with truth, a map, notes; with everything in it, by content."""
    home = tmp_path / "home"
    truth = np.where(np.arange(16) < 8, -0.5, 0.75).astype("f4") * np.ones((12, 1), "f4")
    write_hci(home / "data" / "toy", random_views((3, 3, 12, 16, 3)), disparity=truth)
    (home / "data" / "notes.txt").write_text("years of work")
    (home / "maps").mkdir()
    write_pfm(home / "maps" / "map.pfm", truth)
    return home


def _files(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def _evaluate(home, out, *options):
    scene, result = home / "data" / "toy", home / "maps" / "map.pfm"
    words = [result, scene, "--out", out, "--crop", 2, *options]
    return _main.main(["eval", *map(str, words)])


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("data/toy", "is the input"),
        ("data", "holds the input"),
        ("data/toy/result", "lies in the input"),
        ("maps", "holds the input"),
        (".", "holds"),
        ("data/..", "holds"),
    ],
)
def test_inputs_are_safe(user, capsys, out, message, overwrite):
    before = _files(user)
    assert _evaluate(user, f"{user}/{out}", *overwrite) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("mvedge: error: ")
    assert message in error
    assert _files(user) == before
    assert not (user / "data" / "toy" / "result").exists()


@pytest.mark.parametrize("command", ["depth", "edges", "optimize"])
@pytest.mark.parametrize("out", ["data/toy", "data", "data/toy/result"])
def test_every_command_spares_its_scene(user, capsys, command, out):
    before = _files(user)
    words = [command, str(user / "data" / "toy"), str(user / out), "--overwrite"]
    assert _main.main(words) == 2
    assert "the input" in capsys.readouterr().err
    assert _files(user) == before


@pytest.mark.parametrize(
    "words", [["demo", "OUT"], ["render", "demo", "OUT"]], ids=["demo", "render"]
)
def test_commands_without_a_scene_spare_other_folders(user, capsys, words):
    before = _files(user)
    words = [str(user / "data") if word == "OUT" else word for word in words]
    assert _main.main([*words, "--overwrite"]) == 2
    assert "is not a result of mvedge" in capsys.readouterr().err
    assert _files(user) == before


def test_an_input_behind_a_link_is_safe(user, capsys):
    (user / "link").symlink_to(user / "data" / "toy")
    before = _files(user)
    words = [user / "maps" / "map.pfm", user / "link", "--crop", 2, "--out", user / "data" / "toy"]
    assert _main.main(["eval", *map(str, words), "--overwrite"]) == 2
    assert "is the input" in capsys.readouterr().err
    assert _files(user) == before


@pytest.mark.parametrize("out", [".", "..", "../.."])
def test_the_working_directory_is_safe(user, tmp_path, monkeypatch, capsys, out):
    here = tmp_path / "somewhere" / "else"
    here.mkdir(parents=True)
    (here / "mine.txt").write_text("mine")
    monkeypatch.chdir(here)
    assert _evaluate(user, out, "--overwrite") == 2
    assert "working directory" in capsys.readouterr().err
    assert (here / "mine.txt").read_text() == "mine"
    assert Path.cwd() == here


@pytest.mark.parametrize("target", ["folder", "file", "nothing"])
def test_links_are_refused(user, capsys, target):
    goal = user / "goal"
    if target == "folder":
        goal.mkdir()
    elif target == "file":
        goal.write_text("goal")
    (user / "out").symlink_to(goal)
    assert _evaluate(user, user / "out", "--overwrite") == 2
    assert "is a link" in capsys.readouterr().err
    assert (user / "out").is_symlink()
    assert goal.exists() == (target != "nothing")


def test_mount_points_are_refused(user, capsys, monkeypatch):
    out = user / "out"
    out.mkdir()
    monkeypatch.setattr(_output.os.path, "ismount", lambda path: Path(path) == out)
    assert _evaluate(user, out, "--overwrite") == 2
    assert "mount point" in capsys.readouterr().err


def test_only_an_earlier_result_is_replaced(user, capsys):
    out = user / "out"
    assert _evaluate(user, out) == 0
    written = set(_files(out))
    assert Path(MARKER) in written
    assert _evaluate(user, out) == 2
    assert "pass --overwrite" in capsys.readouterr().err
    assert _evaluate(user, out, "--overwrite") == 0
    assert set(_files(out)) == written
    # A file of the user's in it, even deep inside, makes it theirs.
    (out / "mine").mkdir()
    (out / "mine" / "notes.txt").write_text("mine")
    assert _evaluate(user, out, "--overwrite") == 2
    assert "which mvedge did not write" in capsys.readouterr().err
    assert (out / "mine" / "notes.txt").read_text() == "mine"
    assert {path.name for path in user.iterdir()} == {"data", "maps", "out"}


@pytest.mark.parametrize(
    "marker",
    [None, "", "[]", "{", '{"program": "other", "written": []}', '{"program": "mvedge_jax"}'],
)
def test_a_folder_without_a_sound_marker_is_refused(user, capsys, marker):
    out = user / "out"
    out.mkdir()
    (out / "disparity.pfm").write_text("by hand")
    if marker is not None:
        (out / MARKER).write_text(marker)
    before = _files(user)
    assert _evaluate(user, out, "--overwrite") == 2
    assert "is not a result of mvedge" in capsys.readouterr().err
    assert _files(user) == before


def test_a_file_is_not_replaced(user, capsys):
    (user / "out").write_text("mine")
    assert _evaluate(user, user / "out", "--overwrite") == 2
    assert "is a file" in capsys.readouterr().err
    assert (user / "out").read_text() == "mine"


@pytest.mark.parametrize("start", ["missing", "empty", "result"])
def test_what_appears_during_the_run_stays(user, capsys, monkeypatch, start):
    out = user / "out"
    options = ()
    if start == "empty":
        out.mkdir()
    elif start == "result":
        assert _evaluate(user, out) == 0
        options = ("--overwrite",)
    before = _files(out)
    draw = _eval._draw

    def draw_while_the_user_works(*arguments):
        out.mkdir(exist_ok=True)
        (out / "mine.txt").write_text("mine")
        draw(*arguments)

    monkeypatch.setattr(_eval, "_draw", draw_while_the_user_works)
    assert _evaluate(user, out, *options) == 2
    error = capsys.readouterr().err
    assert f"is in {user / 'out-2'} instead" in error
    assert _files(out) == {**before, Path("mine.txt"): b"mine"}
    # The result is not lost either.
    assert (user / "out-2" / "scores.json").exists()
    assert {path.name for path in user.iterdir()} == {"data", "maps", "out", "out-2"}


def test_an_interrupted_swap_puts_the_earlier_result_back(user, monkeypatch):
    out = user / "out"
    with output_folder(out) as folder:
        (folder / "old.txt").write_text("old")
    before = _files(user)
    rename = Path.rename

    def interrupted(self, target):
        if Path(target) == out and not self.name.endswith(".old"):
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt), output_folder(out, overwrite=True) as folder:
        (folder / "new.txt").write_text("new")
    assert _files(user) == before
    assert {path.name for path in user.iterdir()} == {"data", "maps", "out"}


def test_removal_takes_only_what_was_written(user, monkeypatch, capsys):
    """Even a file that comes between the last check and the swap survives."""
    out = user / "out"
    with output_folder(out) as folder:
        (folder / "old.txt").write_text("old")
    rename = Path.rename

    def late(self, target):
        if self == out:
            (out / "late.txt").write_text("mine")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", late)
    with output_folder(out, overwrite=True) as folder:
        (folder / "new.txt").write_text("new")
    assert set(_files(out)) == {Path("new.txt"), Path(MARKER)}
    (kept,) = user.glob(".out-*.old")
    assert set(_files(kept)) == {Path("late.txt")}
    assert kept.name in capsys.readouterr().err.replace("\n", "")


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "deep" / "out"

    def interrupted():
        with output_folder(target) as folder:
            (folder / "half.txt").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not target.exists()
    assert not list((tmp_path / "deep").iterdir())
    with output_folder(target) as folder:
        (folder / "whole").mkdir()
        (folder / "whole" / "whole.txt").write_text("whole")
    assert set(_files(target)) == {Path("whole/whole.txt"), Path(MARKER)}
    record = json.loads((target / MARKER).read_text())
    assert record["written"] == [MARKER, "whole", "whole/whole.txt"]
    with output_folder(target, overwrite=True) as folder:
        (folder / "new.txt").write_text("new")
    assert set(_files(target)) == {Path("new.txt"), Path(MARKER)}
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out"]


_HOLDER = """
import sys, time
from pathlib import Path
from mvedge_jax.cli._output import output_folder
with output_folder(Path(sys.argv[1])) as folder:
    (folder / "first.txt").write_text("first")
    print("inside", flush=True)
    sys.stdin.readline()
"""


def _holder(out):
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(out)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "inside\n"
    return process


def test_a_second_process_is_refused_and_death_releases(user, capsys):
    out = user / "out"
    first = _holder(out)
    assert _evaluate(user, out) == 2
    assert "written by another process" in capsys.readouterr().err
    first.communicate("\n")
    assert first.returncode == 0
    assert set(_files(out)) == {Path("first.txt"), Path(MARKER)}
    second = _holder(user / "other")
    second.send_signal(signal.SIGKILL)
    second.communicate()
    assert _evaluate(user, user / "other") == 0
    # What the killed one had begun is gone, and its lock.
    assert {path.name for path in user.iterdir()} == {"data", "maps", "out", "other"}


def test_leftovers_are_removed_and_a_result_put_aside_comes_back(user, capsys):
    out = user / "out"
    assert _evaluate(user, out) == 0
    before = _files(out)
    # Killed within the swap: the earlier result is aside, the new one not yet in its place.
    out.rename(user / ".out-abcdefgh.old")
    begun = user / ".out-12345678"
    begun.mkdir()
    (begun / ".mvedge-unfinished").touch()
    (begun / "half.txt").write_text("half")
    mine = user / ".out-abcd1234"
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    (user / ".out-99999999").mkdir()
    assert _evaluate(user, out) == 2
    assert "pass --overwrite" in capsys.readouterr().err
    assert _files(out) == before
    assert {path.name for path in user.iterdir()} == {"data", "maps", "out", mine.name}
    assert (mine / "notes.txt").read_text() == "mine"
    # Killed after the swap: the new one is in its place, the earlier one not yet removed.
    with output_folder(user / "earlier") as folder:
        (folder / "old.txt").write_text("old")
    (user / "earlier").rename(user / ".out-zzzzzzzz.old")
    assert _evaluate(user, out, "--overwrite") == 0
    assert {path.name for path in user.iterdir()} == {"data", "maps", "out", mine.name}


def test_a_full_disk_is_named(user):
    def full():
        with output_folder(user / "out"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match=r"OUT, .*out, could not be written: .*No space left"):
        full()
    assert {path.name for path in user.iterdir()} == {"data", "maps"}


def _race(out, start, outcomes):
    while time.time() < start:
        pass
    try:
        with output_folder(Path(out)) as folder:
            (folder / f"{os.getpid()}.txt").write_text("mine")
    except (ValueError, FileExistsError):
        outcomes.put(None)
    else:
        outcomes.put(os.getpid())


def test_of_many_processes_one_writes(tmp_path):
    """Whoever reports success has its result there."""
    context = multiprocessing.get_context("spawn")
    outcomes = context.Queue()
    start = time.time() + 8
    workers = [
        context.Process(target=_race, args=(tmp_path / "out", start, outcomes)) for _ in range(4)
    ]
    for worker in workers:
        worker.start()
    winners = {outcomes.get(timeout=60) for _ in workers} - {None}
    for worker in workers:
        worker.join()
    assert len(winners) == 1
    assert set(_files(tmp_path / "out")) == {Path(f"{winners.pop()}.txt"), Path(MARKER)}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_reports_are_json_that_everyone_reads(tmp_path):
    """NaN and Infinity are none of JSON's numbers."""
    path = tmp_path / "report.json"
    write_json(path, {"a": [float("inf"), 1.5, (float("nan"), 2)], "b": {"c": None, "d": "NaN"}})

    def refuse(constant):
        raise AssertionError(constant)

    found = json.loads(path.read_text(), parse_constant=refuse)
    assert found == {"a": [None, 1.5, [None, 2]], "b": {"c": None, "d": "NaN"}}
