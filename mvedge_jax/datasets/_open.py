"""Recognizes the layout of a light field and opens it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ._grid import is_grid, open_grid
from ._hci import is_hci, open_hci
from ._hdf5 import open_hdf5
from ._limits import memory_limit, some
from ._lytro import open_mat
from ._source import Source
from ._stanford import is_stanford, open_stanford

_LAYOUTS = (
    "input_CamNNN.png (HCI 4D benchmark), out_RR_CC_<y>_<x>.png (Stanford archive), *_RR_CC.png, "
    ".jpg or .bmp (any grid), a .h5 (old HCI benchmark) or a .mat file (Lytro)"
)
_FOLDERS = ((is_hci, open_hci), (is_stanford, open_stanford), (is_grid, open_grid))
_FILES = {".h5": open_hdf5, ".hdf5": open_hdf5, ".mat": open_mat}
# Largest number of folders, and of files in each, that are inspected for an error message.
_MOST = 200


@contextmanager
def open_source(path: Path, *, max_gb: float | None = None) -> Iterator[Source]:
    """Recognizes the layout of a folder or file and opens it; see `load_light_field`.

    Args:
        path: folder or file.
        max_gb: gigabytes that it may take, see `load_light_field`.

    Yields:
        The opened source, closed on the way out.

    Raises:
        FileNotFoundError: if there is nothing at `path` or no light field in it.
        ValueError: if the file is of an unknown type, or its contents contradict each other.
    """
    if path.is_dir():
        names = sorted(file.name for file in path.iterdir() if not file.name.startswith("."))
        for recognize, open_folder in _FOLDERS:
            if recognize(names):
                yield open_folder(path, names)
                return
        files = [name for name in names if Path(name).suffix.lower() in _FILES]
        if len(files) != 1:
            raise FileNotFoundError(_nothing(path, names, files or _children(path, names)))
        path = path / files[0]
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not there; expected a folder or file: {_LAYOUTS}.")
    opener = _FILES.get(path.suffix.lower())
    if opener is None:
        raise ValueError(f"{path} is not a light field that can be read; expected {_LAYOUTS}.")
    with opener(path, memory_limit(max_gb)) as source:
        yield source


def _children(path: Path, names: Sequence[str]) -> list[str]:
    """Folders in a folder that hold a light field."""
    found = []
    for child in [path / name for name in names[:_MOST] if (path / name).is_dir()]:
        try:
            files = [file.name for file, _ in zip(child.iterdir(), range(_MOST), strict=False)]
        except OSError:  # not ours to read
            continue
        held = [name for name in files if Path(name).suffix.lower() in _FILES]
        if len(held) == 1 or any(recognize(files) for recognize, _ in _FOLDERS):
            found.append(child.name)
    return found


def _nothing(path: Path, names: Sequence[str], inside: Sequence[str]) -> str:
    """Message about a folder without a light field, with those `inside` that are one."""
    if len(inside) == 1:
        return f"{path} holds no light field itself, but {inside[0]} in it is one: name that."
    if inside:
        return (
            f"{path} holds no light field itself, but {len(inside)} in it: {some(inside)}; name "
            "one of them."
        )
    found = f"{len(names)} files, such as {some(names[:1])}" if names else "an empty folder"
    return f"{path} holds no light field: {found}; expected {_LAYOUTS}."
