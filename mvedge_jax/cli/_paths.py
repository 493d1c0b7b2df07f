"""Several inputs and one output in a row of arguments; what files of a photograph are called."""

from collections.abc import Sequence
from pathlib import Path


def scenes_and_out(paths: Sequence[Path]) -> tuple[list[Path], Path]:
    """Splits `SCENES... OUT`.

    Args:
        paths: as given.

    Returns:
        The scenes, and the folder to make.

    Raises:
        ValueError: there are fewer than two.
        FileNotFoundError: a scene is not there.
    """
    if len(paths) < 2:
        raise ValueError(f"expected SCENES... OUT, at least one scene and OUT, got {len(paths)}.")
    *scenes, out = map(Path, paths)
    for scene in scenes:
        if not scene.exists():
            raise FileNotFoundError(f"{scene}: there is no such file or folder.")
    return scenes, out


def stem_of(name: str) -> str:
    """How the files of a photograph begin, which may lie in folders of its own.

    Args:
        name: of the photograph.

    Returns:
        Its folders and its name without the ending.
    """
    return "_".join(Path(name).with_suffix("").parts)
