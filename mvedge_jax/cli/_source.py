"""What a result says it was made from; nothing in it is taken for granted."""

import json
import warnings
from pathlib import Path
from typing import Any

from mvedge_jax.datasets import load_light_field
from mvedge_jax.lightfield import LightField

# Bytes that a report may have.
_MOST = 10**8
# How a scene was read.
_READING: dict[str, tuple[type, ...]] = {
    "views": (int, type(None)),
    "scale": (int, float),
    "flip_u": (bool,),
    "flip_v": (bool,),
    "swap_axes": (bool,),
    "positions": (str, type(None)),
}


def read_json(path: Path) -> dict[str, Any]:
    """Reads a record that an earlier run wrote.

    Args:
        path: the file.

    Returns:
        Its fields.

    Raises:
        ValueError: it is no regular file, too long, or holds something else.
    """
    try:
        if path.is_file() and path.stat().st_size <= _MOST:
            found = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(found, dict):
                return found
    except (OSError, ValueError, RecursionError):
        pass
    raise ValueError(f"{path} could not be read as a report of mvedge.")


def read_scene(scene: Path, **reading: Any) -> tuple[LightField, list[str]]:
    """Reads a light field.

    Args:
        scene: folder or file.
        reading: options of `load_light_field`.

    Returns:
        It, and what the reader warns of, for the user and the report.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        light_field = load_light_field(scene, **reading)
    return light_field, [str(one.message) for one in caught if one.category is UserWarning]


def source_of(scene: Path, **reading: Any) -> dict[str, Any]:
    """What a report tells of its light field, for `scene_of`.

    Args:
        scene: its path.
        reading: options of `load_light_field` with which it was read.

    Returns:
        The record.
    """
    return {"path": str(scene.resolve()), **reading}


def scene_of(result: Path, *, advice: str) -> tuple[Path, dict[str, Any]]:
    """The light field that a result was made from.

    Args:
        result: folder with a report.
        advice: what to do where it does not tell, as the end of a sentence.

    Returns:
        Its path, and the options of `load_light_field` with which it was read.

    Raises:
        ValueError: the report does not tell.
        FileNotFoundError: the light field is gone.
    """
    file = result / "report.json"
    try:
        source = read_json(file)["source"]
        scene = Path(source["path"])
        reading = {name: value for name, value in source.items() if name != "path"}
        if not all(isinstance(value, _READING[name]) for name, value in reading.items()):
            raise ValueError(reading)
    except (ValueError, KeyError, TypeError):
        raise ValueError(f"{file} does not tell its light field; {advice}.") from None
    if not scene.exists():
        raise FileNotFoundError(f"{scene}, the light field of {result}, is gone; {advice}.")
    return scene, reading
