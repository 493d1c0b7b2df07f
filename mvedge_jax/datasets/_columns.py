"""The points that earlier runs wrote."""

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def columns_of(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a file of points (.npz), for as long as they are being looked at.

    Args:
        path: the file; nothing in it is ever unpickled.

    Yields:
        Every column by its name. What a reader finds wrong with them, as a missing name or a shape
        that does not fit, is said with the file's own name.

    Raises:
        ValueError: the file is damaged, or the reader refused a column.
    """
    try:
        # Given a name, NumPy leaves what is no archive open.
        with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as stored:
            yield {name: np.asarray(stored[name]) for name in stored.files}
    except (
        AttributeError, KeyError, TypeError, ValueError, OSError, EOFError,
        zipfile.BadZipFile, zlib.error,
    ) as reason:  # fmt: skip
        raise ValueError(f"{path} could not be read as points: {reason}.") from None
