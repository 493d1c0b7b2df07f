"""Depth maps of COLMAP's dense reconstruction."""

import os
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

_HEADER = re.compile(rb"(\d{1,9})&(\d{1,9})&(\d{1,9})&")


def read_colmap_depth(path: str | os.PathLike) -> Float[np.ndarray, "y x"]:
    """Reads a depth map that COLMAP's `patch_match_stereo` wrote.

    Such files are in `stereo/depth_maps` of a dense workspace, one per undistorted photograph:
    `NAME.photometric.bin` and `NAME.geometric.bin`. A header of text, `width&height&channels&`, is
    followed by little-endian float32 values, row by row.

    Args:
        path: a `.bin` file.

    Returns:
        Distances along the optical axis, in the unit of the model's poses; 0 where COLMAP has none.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it has another header, another number of channels than one, another number of
            bytes than its header says, or values that are no distances.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     place = Path(folder) / "a.png.geometric.bin"
        ...     _ = place.write_bytes(b"2&1&1&" + np.array([1.5, 0.0], "<f4").tobytes())
        ...     read_colmap_depth(place).tolist()
        [[1.5, 0.0]]
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path} is not there; expected a depth map of COLMAP (.bin).")
    data = path.read_bytes()
    header = _HEADER.match(data)
    if header is None:
        raise ValueError(
            f"{path} is not a depth map of COLMAP: expected it to begin with "
            f"'width&height&channels&', found {data[:16]!r}."
        )
    width, height, channels = (int(word) for word in header.groups())
    if channels != 1:
        more = "; three are a map of normals" if channels == 3 else ""
        raise ValueError(f"{path} has {channels} channels; expected one, of depth{more}.")
    if not (width and height):
        raise ValueError(f"{path} has {width}x{height} px; expected at least one.")
    have, need = len(data) - header.end(), 4 * width * height
    if have != need:
        fault = "is truncated" if have < need else "has bytes to spare"
        raise ValueError(
            f"{path} {fault}: expected {need} bytes for {width}x{height} values, found {have}."
        )
    depth = np.frombuffer(data, "<f4", offset=header.end()).reshape(height, width)
    wrong = ~(np.isfinite(depth) & (depth >= 0))
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        raise ValueError(
            f"{path} holds {depth[y, x]} at row {y}, column {x} ({wrong.sum()} such values); "
            "expected distances, finite and at least 0."
        )
    return depth.astype(np.float32)
