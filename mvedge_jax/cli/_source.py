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
    """Reads the report of an earlier run; a ValueError names what is none."""
    try:
        if path.is_file() and path.stat().st_size <= _MOST:
            found = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(found, dict):
                return found
    except (OSError, ValueError, RecursionError):
        pass
    raise ValueError(f"{path} could not be read as a report of mvedge.")


def read_scene(scene: Path, **reading: Any) -> tuple[LightField, list[str]]:
    """A light field, and the warnings of its reader, for the user and the report."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        light_field = load_light_field(scene, **reading)
    return light_field, [str(one.message) for one in caught if one.category is UserWarning]


def source_of(scene: Path, **reading: Any) -> dict[str, Any]:
    """The record in a report of a light field and how it was read, for `scene_of`."""
    return {"path": str(scene.resolve()), **reading}


def scene_of(result: Path, *, advice: str) -> tuple[Path, dict[str, Any]]:
    """Path and options of `load_light_field` of the light field of a result, by its report.

    `advice`, the end of a sentence, says what to do if it is not told or gone.
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
