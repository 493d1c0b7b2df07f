"""Point files of earlier runs."""

import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np


@contextmanager
def columns_of(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """Opens a file of points (.npz) and yields its columns.

    Args:
        path: the file; nothing in it is ever unpickled.

    Yields:
        Every column by its name. Errors in the body, such as a missing column or a wrong shape,
        are raised with the name of the file.

    Raises:
        ValueError: the file is damaged, or the body refused a column.
    """
    try:
        # Given a path, NumPy does not close files that are not archives.
        with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as stored:
            yield {name: np.asarray(stored[name]) for name in stored.files}
    except (
        AttributeError, KeyError, TypeError, ValueError, OSError, EOFError,
        zipfile.BadZipFile, zlib.error,
    ) as reason:  # fmt: skip
        raise ValueError(f"{path} could not be read as points: {reason}.") from None
