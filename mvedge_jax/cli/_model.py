"""`--preset` and `--set`: the model that a command runs, and what its report says of it."""

import contextlib
import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import equinox as eqx
import numpy as np
import tyro

from mvedge_jax._paths import describe, replaced, value_at
from mvedge_jax._settings import Setting, of_preset, with_settings
from mvedge_jax.depth import EdgeDepth
from mvedge_jax.lightfield import LightField

_Module = TypeVar("_Module", bound=eqx.Module)
Settings = Annotated[
    tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="PATH=VALUE")
]


@dataclasses.dataclass(frozen=True)
class ModelOptions:
    """The options of every command that runs an `EdgeDepth`.

    Attributes:
        preset: of the steps: full has edges and a label measured at every pixel; learned is full
            with numbers and a network learned from random scenes; edges has the edges alone,
            splatted with transmittance; thesis has the steps of Chapters 4 and 6.
        set: a number or static field of the model by its path, such as smoothness.color=.3 or
            refine.solves=1, or refine.outline=none to leave a part out; may be given several times.
            report.json lists all paths.
        learned: learned.json of `mvedge learn`, whose factors the numbers are multiplied by and
            whose arrays replace those of networks, or best.json of `mvedge sweep`, whose setting
            they take; of the same preset. --set wins.
    """

    preset: Literal["full", "learned", "edges", "thesis"] = "full"
    set: Settings = ()
    learned: Annotated[Path | None, tyro.conf.arg(name="model", metavar="FILE")] = None

    def check(self, *, all_views: bool = False) -> EdgeDepth:
        """Refuses mistakes before any light field is read, see `model`; a model to look at."""
        return self._settled(of_preset(self.preset), all_views)

    def model(self, light_field: LightField, *, all_views: bool = False) -> EdgeDepth:
        """The model for a light field, whose disparity range is measured if it is unknown."""
        views = "all" if all_views else "crosshair"
        model = EdgeDepth.for_light_field(light_field, preset=self.preset, views=views)
        return self._settled(model, all_views)

    def _settled(self, model: EdgeDepth, all_views: bool) -> EdgeDepth:
        if all_views and model.dense is None:
            raise ValueError(
                f"--all-views needs dense labels, which preset {self.preset} does not have; leave "
                "out one of both."
            )
        if self.learned is not None:
            model = with_learned(model, self.learned, self.preset)
        return settled(model, self.set)

    def absolute(self) -> "ModelOptions":
        """The same, for processes that have other working folders."""
        learned = None if self.learned is None else self.learned.absolute()
        return dataclasses.replace(self, learned=learned)

    def described(self, model: EdgeDepth) -> dict[str, Any]:
        """What a report says of the model: preset, numbers and static fields by path."""
        learned = {} if self.learned is None else {"model": str(self.learned)}
        return {"preset": self.preset, **learned, **described(model)}


ModelArg = Annotated[ModelOptions, tyro.conf.arg(name="")]
# What a command runs that is not told otherwise.
FULL = ModelOptions()


def settled(model: _Module, words: tuple[str, ...]) -> _Module:
    """A model with what `--set` asks for: `PATH=VALUE`, later ones win; errors name the setting."""
    for path, value in settings_of(words).items():
        try:
            model = with_settings(model, {path: value})
        except ValueError as mistake:
            raise ValueError(f"--set {path}: {mistake}") from None
    return model


def with_learned(model: _Module, path: Path, preset: str) -> _Module:
    """A model with what `mvedge learn` learned or `mvedge sweep` found for its preset.

    Factors change what the model has for the views of its light field: numbers in px per view step
    depend on how many there are. Errors name the file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"--model {path}: there is no such file.")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        made = found["preset"]
        if made != preset:
            raise ValueError(f"it is for --preset {made}, not {preset}.")
        if "setting" in found:
            return with_settings(model, found["setting"])
        factors = {name: float(factor) for name, factor in found["factors"].items()}
        values = {name: factor * float(value_at(model, name)) for name, factor in factors.items()}
        arrays = {n: v for n, v in found.get("numbers", {}).items() if np.ndim(v) > 0}
        return with_settings(_with_arrays(model, arrays), values)
    except KeyError as missing:
        raise ValueError(
            f"--model {path}: expected learned.json of `mvedge learn` or best.json of `mvedge "
            f"sweep`, but it has no {missing}."
        ) from None
    except (ValueError, TypeError, AttributeError, RecursionError) as mistake:
        raise ValueError(f"--model {path}: {mistake}") from None


def _with_arrays(model: _Module, arrays: dict[str, Any]) -> _Module:
    """A model with other arrays, such as the weights of a network."""
    for name, values in arrays.items():
        new = np.asarray(values, np.float32)
        now = np.asarray(value_at(model, name))
        if new.shape != now.shape:
            raise ValueError(f"`{name}` has the shape {now.shape} in the model, not {new.shape}.")
        if not np.isfinite(new).all():
            raise ValueError(f"`{name}` must be finite.")
        model = replaced(model, {name: new})
    return model


def settings_of(words: tuple[str, ...]) -> dict[str, Setting]:
    """Values by path of words `PATH=VALUE`, unchecked; later ones win."""
    found = {}
    for word in words:
        path, _, text = word.partition("=")
        if not (path and text):
            raise ValueError(f"--set {word}: expected PATH=VALUE, such as smoothness.color=0.3.")
        found[path] = read_value(text)
    return found


def read_value(text: str) -> Setting:
    """What a word of the command line means: true, false, none, a number, or itself."""
    if text in ("true", "false"):
        return text == "true"
    if text == "none":
        return None
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def described(model: eqx.Module) -> dict[str, Any]:
    """Numbers and static fields of a model by path, for a report."""
    rows = describe(model)
    return {
        "numbers": {row.path: _plain(row.value) for row in rows if not row.static},
        "static fields": {row.path: _plain(row.value) for row in rows if row.static},
    }


def _plain(value: Any) -> Any:
    """A value as JSON has it; numbers as short as their precision allows."""
    if eqx.is_array(value):
        array = np.asarray(value)
        return float(str(array)) if array.ndim == 0 else array.tolist()
    return value if isinstance(value, bool | int | float | str | tuple) else repr(value)
