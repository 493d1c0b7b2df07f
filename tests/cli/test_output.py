"""Nothing of a user's is ever deleted: what --overwrite replaces, what it refuses, and locks."""

import errno
import json
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from datasets.layouts import random_views, write_hci

from mvedge_jax.cli import _eval, _output
from mvedge_jax.cli._output import MARKER, output_folder, write_json
from mvedge_jax.datasets import write_pfm


@pytest.fixture
def user(tmp_path):
    """A user's folder: a scene with truth, a map, notes."""
    home = tmp_path / "home"
    truth = np.where(np.arange(16) < 8, -0.5, 0.75).astype("f4") * np.ones((12, 1), "f4")
    write_hci(home / "data" / "toy", random_views((3, 3, 12, 16, 3)), disparity=truth)
    (home / "data" / "notes.txt").write_text("years of work")
    (home / "maps").mkdir()
    write_pfm(home / "maps" / "map.pfm", truth)
    return home


@pytest.fixture
def evaluate(user, mvedge):
    """Runs `mvedge eval` of the map into a folder; looks at the exit code, gives the complaints."""

    def run(out, *options, code=0, scene=user / "data" / "toy"):
        words = ("--out", out, "--crop", 2, *options)
        return mvedge("eval", user / "maps" / "map.pfm", scene, *words, code=code).err

    return run


def _files(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def _names(folder):
    return {path.name for path in folder.iterdir()}


def test_an_input_behind_a_link_is_safe(user, evaluate):
    (user / "link").symlink_to(user / "data" / "toy")
    before = _files(user)
    said = evaluate(user / "data" / "toy", "--overwrite", code=2, scene=user / "link")
    assert "is the input" in said
    assert _files(user) == before


def test_the_folder_that_the_command_is_called_in_is_safe(user, evaluate, monkeypatch):
    here = user / "here"
    here.mkdir()
    (here / "mine.txt").write_text("mine")
    monkeypatch.chdir(here)
    assert "working directory" in evaluate(".", "--overwrite", code=2)
    assert (here / "mine.txt").read_text() == "mine"
    assert Path.cwd() == here


@pytest.mark.parametrize("target", ["folder", "file", "nothing"])
def test_links_are_refused(user, evaluate, target):
    goal, out = user / "goal", user / "out"
    if target == "folder":
        goal.mkdir()
    elif target == "file":
        goal.write_text("goal")
    out.symlink_to(goal)
    assert "is a link" in evaluate(out, "--overwrite", code=2)
    assert out.is_symlink()
    assert goal.exists() == (target != "nothing")


def test_mount_points_and_files_are_refused(user, evaluate, monkeypatch):
    out = user / "out"
    out.write_text("mine")
    assert "is a file" in evaluate(out, "--overwrite", code=2)
    assert out.read_text() == "mine"
    out.unlink()
    out.mkdir()
    monkeypatch.setattr(_output.os.path, "ismount", lambda path: Path(path) == out)
    assert "mount point" in evaluate(out, "--overwrite", code=2)


def test_only_an_earlier_result_is_replaced(user, evaluate):
    out = user / "out"
    evaluate(out)
    written = set(_files(out))
    assert Path(MARKER) in written
    assert "pass --overwrite" in evaluate(out, code=2)
    evaluate(out, "--overwrite")
    assert set(_files(out)) == written
    # A file of the user's in it, even deep inside, makes it theirs.
    (out / "mine").mkdir()
    (out / "mine" / "notes.txt").write_text("mine")
    assert "which mvedge did not write" in evaluate(out, "--overwrite", code=2)
    assert (out / "mine" / "notes.txt").read_text() == "mine"
    assert _names(user) == {"data", "maps", "out"}


@pytest.mark.parametrize(
    "marker",
    [None, "", "[]", "{", '{"program": "other", "written": []}', '{"program": "mvedge_jax"}'],
)
def test_a_folder_without_a_sound_marker_is_refused(user, evaluate, marker):
    out = user / "out"
    out.mkdir()
    (out / "disparity.pfm").write_text("by hand")
    if marker is not None:
        (out / MARKER).write_text(marker)
    before = _files(user)
    assert "is not a result of mvedge" in evaluate(out, "--overwrite", code=2)
    assert _files(user) == before


@pytest.mark.parametrize("start", ["missing", "empty", "result"])
def test_what_appears_during_the_run_stays(user, evaluate, monkeypatch, start):
    out = user / "out"
    if start == "empty":
        out.mkdir()
    elif start == "result":
        evaluate(out)
    before, draw = _files(out), _eval._draw

    def draw_while_the_user_works(*arguments):
        out.mkdir(exist_ok=True)
        (out / "mine.txt").write_text("mine")
        draw(*arguments)

    monkeypatch.setattr(_eval, "_draw", draw_while_the_user_works)
    said = evaluate(out, *(["--overwrite"] if start == "result" else []), code=2)
    assert f"is in {user / 'out-2'} instead" in said
    assert _files(out) == {**before, Path("mine.txt"): b"mine"}
    # The result is not lost either.
    assert (user / "out-2" / "scores.json").exists()
    assert _names(user) == {"data", "maps", "out", "out-2"}


@pytest.fixture
def earlier(tmp_path):
    """A folder `out` that holds an earlier result."""
    with output_folder(tmp_path / "out") as folder:
        (folder / "old.txt").write_text("old")
    return tmp_path / "out"


def _replace(out):
    with output_folder(out, overwrite=True) as folder:
        (folder / "new.txt").write_text("new")


def test_an_interrupted_swap_puts_the_earlier_result_back(earlier, monkeypatch):
    before, rename = _files(earlier.parent), Path.rename

    def interrupted(self, target):
        if Path(target) == earlier and not self.name.endswith(".old"):
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        _replace(earlier)
    assert _files(earlier.parent) == before
    assert _names(earlier.parent) == {"out"}


def test_removal_takes_only_what_was_written(earlier, monkeypatch, capsys):
    """Even a file that comes between the last check and the swap survives."""
    rename = Path.rename

    def late(self, target):
        if self == earlier:
            (earlier / "late.txt").write_text("mine")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", late)
    _replace(earlier)
    assert set(_files(earlier)) == {Path("new.txt"), Path(MARKER)}
    (kept,) = earlier.parent.glob(".out-*.old")
    assert set(_files(kept)) == {Path("late.txt")}
    assert kept.name in capsys.readouterr().err.replace("\n", "")


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "deep" / "out"

    def write(error=None):
        with output_folder(target) as folder:
            (folder / "whole").mkdir()
            (folder / "whole" / "whole.txt").write_text("whole")
            if error is not None:
                raise error

    with pytest.raises(KeyboardInterrupt):
        write(KeyboardInterrupt)
    full = OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(OSError, match=r"OUT, .*out, could not be written: .*No space left"):
        write(full)
    assert list((tmp_path / "deep").iterdir()) == []
    write()
    assert set(_files(target)) == {Path("whole/whole.txt"), Path(MARKER)}
    record = json.loads((target / MARKER).read_text())
    assert record["written"] == [MARKER, "whole", "whole/whole.txt"]
    _replace(target)
    assert set(_files(target)) == {Path("new.txt"), Path(MARKER)}
    assert _names(tmp_path / "deep") == {"out"}


_HOLDER = """
import sys
from pathlib import Path
from mvedge_jax.cli._output import output_folder
with output_folder(Path(sys.argv[1])) as folder:
    (folder / "first.txt").write_text("first")
    print("inside", flush=True)
    sys.stdin.readline()
"""


def test_a_second_process_is_refused_and_death_releases(user, evaluate):
    out = user / "out"
    first = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, str(out)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert first.stdout is not None
    assert first.stdout.readline() == "inside\n"
    assert "written by another process" in evaluate(out, code=2)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    evaluate(out)
    # What the killed one had begun is gone, and its lock.
    assert Path("first.txt") not in _files(out)
    assert _names(user) == {"data", "maps", "out"}


def test_of_many_one_writes(tmp_path):
    """Whoever reports success has its result there."""
    together = threading.Barrier(4)

    def race(out, who):
        together.wait()
        try:
            with output_folder(out) as folder:
                (folder / f"{who}.txt").write_text("mine")
        except (ValueError, FileExistsError):
            return None
        return who

    with ThreadPoolExecutor(4) as pool:
        for name in map(str, range(10)):
            outcomes = pool.map(race, 4 * [tmp_path / name], range(4))
            (winner,) = set(outcomes) - {None}
            assert set(_files(tmp_path / name)) == {Path(f"{winner}.txt"), Path(MARKER)}
    assert _names(tmp_path) == set(map(str, range(10)))


def test_leftovers_are_removed_and_a_result_put_aside_comes_back(user, evaluate):
    out = user / "out"
    evaluate(out)
    before = _files(out)
    # Killed within the swap: the earlier result is aside, the new one not yet in its place.
    out.rename(user / ".out-abcdefgh.old")
    begun, mine = user / ".out-12345678", user / ".out-abcd1234"
    begun.mkdir()
    (begun / ".mvedge-unfinished").touch()
    (begun / "half.txt").write_text("half")
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    (user / ".out-99999999").mkdir()
    assert "pass --overwrite" in evaluate(out, code=2)
    assert _files(out) == before
    assert _names(user) == {"data", "maps", "out", mine.name}
    assert (mine / "notes.txt").read_text() == "mine"
    # Killed after the swap: the new one is in its place, the earlier one not yet removed.
    with output_folder(user / "earlier") as folder:
        (folder / "old.txt").write_text("old")
    (user / "earlier").rename(user / ".out-zzzzzzzz.old")
    evaluate(out, "--overwrite")
    assert _names(user) == {"data", "maps", "out", mine.name}


def test_reports_are_json_that_everyone_reads(tmp_path):
    """NaN and Infinity are none of JSON's numbers."""
    path = tmp_path / "report.json"
    write_json(path, {"a": [float("inf"), 1.5, (float("nan"), 2)], "b": {"c": None, "d": "NaN"}})

    def refuse(constant):
        raise AssertionError(constant)

    found = json.loads(path.read_text(), parse_constant=refuse)
    assert found == {"a": [None, 1.5, [None, 2]], "b": {"c": None, "d": "NaN"}}
