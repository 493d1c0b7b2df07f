"""The light field of a result, by its report, which is checked like any input."""

import json
import warnings
from pathlib import Path
from typing import Any

from mvedge_jax.datasets import load_light_field
from mvedge_jax.lightfield import LightField

# Largest size of a report, bytes.
_MOST = 10**8
# Options with which a scene was read.
_READING: dict[str, tuple[type, ...]] = {
    "views": (int, type(None)),
    "scale": (int, float),
    "flip_u": (bool,),
    "flip_v": (bool,),
    "swap_axes": (bool,),
    "positions": (str, type(None)),
}


def read_json(path: Path) -> dict[str, Any]:
    """Reads a report of an earlier run.

    Args:
        path: the file.

    Returns:
        Its fields.

    Raises:
        ValueError: the file is not regular, too long, or not a report.
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
        The light field, and warnings of its reader, for the user and the report.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        light_field = load_light_field(scene, **reading)
    return light_field, [str(one.message) for one in caught if one.category is UserWarning]


def source_of(scene: Path, **reading: Any) -> dict[str, Any]:
    """The record of a light field in a report, for `scene_of`.

    Args:
        scene: its path.
        reading: options of `load_light_field` with which it was read.

    Returns:
        The record.
    """
    return {"path": str(scene.resolve()), **reading}


def scene_of(result: Path, *, advice: str) -> tuple[Path, dict[str, Any]]:
    """The light field of a result.

    Args:
        result: a folder with a report.
        advice: what to do if the report does not name it, as the end of a sentence.

    Returns:
        Its path, and the options of `load_light_field` with which it was read.

    Raises:
        ValueError: the report does not name its light field.
        FileNotFoundError: the light field does not exist.
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
