"""Maps of every view, as `mvedge views` writes them."""

from pathlib import Path

import h5py
import numpy as np

# What each array is made of, by the letter of its type.
_KINDS = {"disparity": "f", "error": "f", "source": "iu"}


def view_maps(path: Path, shape: tuple[int, ...], *names: str) -> list[np.ndarray]:
    """Arrays of a views.h5 with views of a shape, by name: disparity, error or source.

    A source is 0 for surfaces visible in the center view, 1 in other views only, 2 in none.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist; `mvedge views` writes it.")
    found = []
    try:
        with h5py.File(path, "r") as file:
            for name in names:
                stored = file.get(name)
                own = isinstance(file.get(name, getlink=True), h5py.HardLink)
                if not own or not isinstance(stored, h5py.Dataset):
                    raise ValueError(f"it has no `{name}` of its own")
                if stored.external or stored.is_virtual:
                    raise ValueError(f"its `{name}` lies in other files")
                if stored.shape != shape or stored.dtype.kind not in _KINDS[name]:
                    raise ValueError(f"its `{name}` is no map of every view, {shape}")
                found.append(np.asarray(stored))
    except (OSError, ValueError, RuntimeError) as reason:
        raise ValueError(f"{path} could not be read: {reason}.") from None
    return found
