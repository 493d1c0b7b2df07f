"""Result folders: written atomically, and never in place of foreign files."""

import contextlib
import csv
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from PIL import Image

from mvedge._version import package_version

from ._common import warn
from ._interruption import GUARD, unfinished
from ._source import read_json

# Lists the files of a run. A folder is replaced only if it has this list and no other files.
MARKER = ".mvedge.json"
# Marks a folder that is being written.
_UNFINISHED = ".mvedge-unfinished"
# Suffix of an earlier result that is being replaced; names of temporary folders have no dot.
_ASIDE = ".old"


@contextlib.contextmanager
def output_folder(
    path: Path, *, inputs: Sequence[Path] = (), overwrite: bool = False
) -> Iterator[Path]:
    """Writes a folder atomically and never deletes foreign files.

    The body writes into a temporary sibling, which is renamed to `path` on success and removed on
    any failure, Ctrl-C included. An earlier result is renamed first and removed last, file by file
    from its own list. A lock beside the folder keeps other processes out; the system releases it
    when the process ends. If a process was killed, the next one with the same `path` removes its
    files and restores a result that it had renamed.

    Args:
        path: the folder to make.
        inputs: files and folders that the command reads.
        overwrite: replace an earlier result instead of refusing.

    Yields:
        The temporary folder to write into.

    Raises:
        ValueError: if `path` is, holds or lies in an input; if it is the working directory or
            holds it; if it is a link or a mount point; if another process writes it.
        FileExistsError: if `path` is a file; if it is not empty and `overwrite` is off, or holds
            other files than an earlier result; if files appeared in it while the body ran. Then
            the new result is kept beside it.
        OSError: if a file cannot be written; the message names `path`.
    """
    if Path(path).is_symlink():
        raise ValueError(f"{path} is a link; name the folder itself as OUT.")
    path = Path(path).resolve()
    _refuse(path, inputs, overwrite)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _alone(path):
        _tidy(path)
        _refuse(path, inputs, overwrite)
        with contextlib.ExitStack() as stack:
            with GUARD:
                temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
                stack.enter_context(unfinished(temporary))
            try:
                temporary.chmod(0o755)
                (temporary / _UNFINISHED).touch()
                yield temporary
                (temporary / _UNFINISHED).unlink(missing_ok=True)
                _mark(temporary)
                with GUARD:
                    _move_in(temporary, path, inputs, overwrite)
            except OSError as error:
                if error.filename is not None or error.errno is None:
                    raise
                # Errors of a full disk do not name the file.
                raise OSError(f"OUT, {path}, could not be written: {error}.") from error
            finally:
                shutil.rmtree(temporary, ignore_errors=True)


def _tidy(path: Path) -> None:
    """Removes files of killed processes beside `path`; its lock is held, so none is alive."""
    name = re.escape(path.name)
    for item in list(path.parent.iterdir()):
        if item.is_symlink() or not item.is_dir():
            continue
        if re.fullmatch(rf"\.{name}-[a-z0-9_]{{8}}", item.name):
            if (item / _UNFINISHED).is_file():
                shutil.rmtree(item, ignore_errors=True)
            else:  # of a process killed early, or foreign
                with contextlib.suppress(OSError):
                    item.rmdir()
        elif re.fullmatch(rf"\.{name}-[a-z0-9_]{{8}}{re.escape(_ASIDE)}", item.name):
            written = _earlier_result(item)
            if written is None:
                with contextlib.suppress(OSError):
                    item.rmdir()
            elif not os.path.lexists(path):
                item.rename(path)
            else:
                _remove(item)


def _refuse(path: Path, inputs: Sequence[Path], overwrite: bool) -> None:
    """Raises if writing to `path` could touch anything but an earlier result."""
    if path.is_symlink():
        raise ValueError(f"{path} is a link; name the folder itself as OUT.")
    if path.exists() and not path.is_dir():
        raise FileExistsError(f"{path} is a file, expected a folder to write into.")
    if os.path.ismount(path):
        raise ValueError(f"{path} is a mount point; choose a folder inside of it as OUT.")
    if Path.cwd().resolve().is_relative_to(path):
        raise ValueError(f"{path} is or holds the working directory; choose another folder as OUT.")
    refuse_inputs(path, inputs)
    if path.is_dir() and any(path.iterdir()):
        if not overwrite:
            raise FileExistsError(
                f"{path} is there already and is not empty; choose another folder or pass "
                "--overwrite."
            )
        written = _earlier_result(path)
        if written is None:
            raise FileExistsError(
                f"{path} is not a result of mvedge (it has no readable {MARKER}), so --overwrite "
                "does not replace it; choose another folder."
            )
        foreign = sorted(_contents(path) - written)
        if foreign:
            more = f" and {len(foreign) - 1} more" if len(foreign) > 1 else ""
            raise FileExistsError(
                f"{path} holds {foreign[0]}{more}, which mvedge did not write, so --overwrite does "
                "not replace it; move that elsewhere or choose another folder."
            )


def refuse_inputs(path: Path, inputs: Sequence[Path]) -> None:
    """Raises a ValueError if an output, resolved, is, holds or lies in an input."""
    for given in inputs:
        # The location of the input and, if it is a link, of its target.
        for source in (Path(os.path.abspath(given)), Path(given).resolve()):
            if source == path:
                raise ValueError(f"OUT, {path}, is the input {given}; choose another folder.")
            if source.is_relative_to(path):
                raise ValueError(f"OUT, {path}, holds the input {given}; choose another folder.")
            if path.is_relative_to(source):
                raise ValueError(f"OUT, {path}, lies in the input {given}; choose another folder.")


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Holds the lock of `path`.

    The file is removed while the lock is held; waiting processes notice and create a new one.
    """
    file = path.with_name(f".{path.name}.lock")
    lock = FileLock(file)
    try:
        with GUARD:
            lock.acquire(timeout=0)
    except Timeout:
        raise ValueError(f"{path} is being written by another process; choose another OUT.") from (
            None
        )
    try:
        with unfinished(file):
            yield
    finally:
        file.unlink(missing_ok=True)
        lock.release()


def _contents(folder: Path) -> set[str]:
    """Everything below a folder, itself not included; links are not followed."""
    return {
        (Path(parent) / name).relative_to(folder).as_posix()
        for parent, folders, files in os.walk(folder)
        for name in (*folders, *files)
    }


def _mark(folder: Path) -> None:
    record = {
        "program": "mvedge_jax",
        "version": package_version(),
        "written": sorted(_contents(folder) | {MARKER}),
    }
    (folder / MARKER).write_text(json.dumps(record, indent=1), encoding="utf-8")


def _earlier_result(folder: Path) -> set[str] | None:
    """Files of an earlier run in `folder`, by its marker; None without a readable one."""
    try:
        record = read_json(folder / MARKER)
        if record["program"] != "mvedge_jax":
            return None
        return {str(name) for name in record["written"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _move_in(new: Path, path: Path, inputs: Sequence[Path], overwrite: bool) -> None:
    """Moves a finished result into place, or beside it if other files have appeared there."""
    aside = None
    try:
        _refuse(path, inputs, overwrite)
        if overwrite and path.is_dir():
            aside = Path(tempfile.mkdtemp(_ASIDE, f".{path.name}-", path.parent))
            path.rename(aside)  # in place of the empty folder
        new.rename(path)  # replaces an empty folder; fails for one with files
    except BaseException as reason:
        if aside is not None and not path.exists():
            aside.rename(path)
        elif aside is not None:
            with contextlib.suppress(OSError):  # keeps the earlier result if `path` exists again
                aside.rmdir()
        if not isinstance(reason, OSError | ValueError):
            raise
        kept = _free_name(path)
        new.rename(kept)
        raise FileExistsError(
            f"The result could not be put in its place ({reason}) and is in {kept} instead."
        ) from reason
    if aside is not None:
        _remove(aside)


def _free_name(path: Path) -> Path:
    count = 2
    while os.path.lexists(candidate := path.with_name(f"{path.name}-{count}")):
        count += 1
    return candidate


def _remove(result: Path) -> None:
    """Removes an earlier result that was renamed: the files of its list only."""
    written = _earlier_result(result) or set()
    for name in sorted(written, key=lambda n: n.count("/"), reverse=True):
        item = result / name
        with contextlib.suppress(OSError):
            item.rmdir() if item.is_dir() and not item.is_symlink() else item.unlink()
    try:
        result.rmdir()
    except OSError:
        warn(f"the earlier result was not removed altogether: {result} holds other files.")


def write_json(path: Path, value: Any) -> None:
    """Writes a report in standard JSON; numbers that are not finite become null."""
    text = json.dumps(_finite(value), indent=2, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Writes a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])


def write_animation(path: Path, pictures: Iterable[np.ndarray]) -> None:
    """Writes a .gif that never ends."""
    first, *others = map(Image.fromarray, pictures)
    options: dict[str, Any] = {"save_all": True, "append_images": others, "loop": 0}
    first.save(path, duration=60, **options)
