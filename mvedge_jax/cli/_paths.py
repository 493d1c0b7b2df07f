"""Splits arguments into inputs and output, and names the files of photographs."""

import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path


def scenes_and_out(paths: Sequence[Path]) -> tuple[list[Path], Path]:
    """Splits `SCENES... OUT`, and refuses scenes that do not exist."""
    if len(paths) < 2:
        raise ValueError(f"expected SCENES... OUT, at least one scene and OUT, got {len(paths)}.")
    *scenes, out = map(Path, paths)
    for scene in scenes:
        if not scene.exists():
            raise FileNotFoundError(f"{scene}: there is no such file or folder.")
    return scenes, out


def stems_of(names: Sequence[str]) -> dict[str, str]:
    """Stems of the files of photographs, which may be in subfolders, by their names.

    Folders and name without its ending; with it, if needed with a number, where stems are equal.
    """
    stems: dict[str, str] = {}
    for whole in (False, True):
        found = {name: _stem(name, whole=whole) for name in names if name not in stems}
        count = Counter([*found.values(), *stems.values()])
        stems |= {name: stem for name, stem in found.items() if count[stem] == 1}
    taken = set(stems.values())
    for name in names:
        if name not in stems:
            number = next(i for i in itertools.count(1) if f"{_stem(name)}_{i}" not in taken)
            stems[name] = f"{_stem(name)}_{number}"
            taken.add(stems[name])
    return stems


def _stem(name: str, *, whole: bool = True) -> str:
    path = Path(name if whole else Path(name).with_suffix(""))
    return "_".join(part for part in path.relative_to(path.anchor).parts if part != "..")
