"""What learning carries from step to step, and its file, from which a stopped run goes on."""

import json
import os
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from ._choice import Values

_FILE = "state.eqx"
# Bytes of the line that a saved state begins with.
_LONGEST_HEADER = 1 << 20


class State(eqx.Module):
    """Everything that a step changes.

    Attributes:
        step: how many steps were done.
        values: what is learned, in the coordinates of `Choice`.
        moments: of the optimizer.
        best: the values of the lowest validation loss; without validation, the last ones.
        best_step: the step after which these were reached.
        losses: mean over the minibatch, per step; NaN for steps to come.
        validation: mean over the validation scenes, per check; NaN for checks to come.
    """

    step: np.ndarray
    values: Values
    moments: Any
    best: Values
    best_step: np.ndarray
    losses: np.ndarray
    validation: np.ndarray

    @staticmethod
    def begin(values: Values, moments: Any, steps: int, checks: int) -> "State":
        """The state before the first step."""
        zero = np.zeros((), np.int64)
        return State(
            zero, values, moments, values, zero, np.full(steps, np.nan), np.full(checks, np.nan)
        )

    def save(self, folder: Path, settings: dict[str, Any]) -> None:
        """Writes the state, whole or not at all, with the settings of its run."""
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = folder / f"{_FILE}.{os.getpid()}"
        try:
            with unfinished.open("wb") as file:
                file.write(json.dumps(settings).encode() + b"\n")
                eqx.tree_serialise_leaves(file, self)
            os.replace(unfinished, folder / _FILE)
        finally:
            unfinished.unlink(missing_ok=True)

    def resumed(self, folder: Path, settings: dict[str, Any]) -> "State":
        """The state in a folder; this one, which a run begins with, if there is none.

        A ValueError says that the earlier run had other settings, or that the file is damaged.
        """
        path = folder / _FILE
        if not path.is_file():
            return self
        try:
            with path.open("rb") as file:
                earlier = json.loads(file.readline(_LONGEST_HEADER))
                known = json.loads(json.dumps(settings))
                names = [name for name in known if earlier.get(name) != known[name]]
                found = self if names else eqx.tree_deserialise_leaves(file, self)
        except (RuntimeError, EOFError, OSError, ValueError, TypeError, AttributeError) as error:
            raise ValueError(f"{path} does not hold a whole state of learning: {error}") from error
        if names:
            name = names[0]
            raise ValueError(
                f"{path} is of a run with `{name}` = {earlier.get(name)!r}, this one has "
                f"{known[name]!r}; choose another folder, or `resume=False` to start anew."
            )
        return found
