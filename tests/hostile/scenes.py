"""Small light fields that hostile files are made from."""

from pathlib import Path

import numpy as np
from datasets.layouts import random_views, write_hci

TRUTH = np.where(np.arange(8) < 4, -0.5, 0.75).astype("f4") * np.ones((6, 1), "f4")


def smooth() -> np.ndarray:
    """Nine views alike, which JPEG keeps."""
    y, x = np.mgrid[:16, :16]
    image = np.stack([8 * y, 8 * x, 4 * (x + y)], -1).astype(np.uint8)
    return np.broadcast_to(image, (3, 3, *image.shape))


def hci(folder: Path) -> Path:
    """A scene of the HCI benchmark with its truth."""
    return write_hci(folder / "scene", random_views(), disparity=TRUTH)
