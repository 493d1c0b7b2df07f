"""Depth maps of COLMAP: by the letter of its description, and what is wrong with a file."""

import numpy as np
import pytest

from experiments.peers.photographs import read_colmap_depth

DEPTH = np.random.default_rng(0).uniform(0.5, 9, (3, 5)).astype(np.float32)
DEPTH[1, 2] = 0


def written(path, depth, header=None):
    """As COLMAP's `Mat::Write`: columns run fastest, then rows, then channels; little-endian."""
    rows, columns = depth.shape
    numbers = [depth[y, x] for y in range(rows) for x in range(columns)]
    header = f"{columns}&{rows}&1&" if header is None else header
    path.write_bytes(header.encode() + np.asarray(numbers, "<f4").tobytes())
    return path


def test_a_map_comes_back(tmp_path):
    found = read_colmap_depth(written(tmp_path / "a.png.geometric.bin", DEPTH))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, DEPTH)
    # The script that COLMAP ships for this format reads it in Fortran's order, and turns it.
    data = (tmp_path / "a.png.geometric.bin").read_bytes().split(b"&", 3)[3]
    theirs = np.frombuffer(data, np.float32).reshape((5, 3, 1), order="F").transpose(1, 0, 2)
    np.testing.assert_array_equal(found, theirs[..., 0])


@pytest.mark.parametrize(
    ("header", "depth", "message"),
    [
        ("5x3x1x", DEPTH, "a.bin is not a depth map of COLMAP: expected it to begin with 'width&"),
        ("5&3&3&", DEPTH, "a.bin has 3 channels; expected one, of depth; three are a map of norm"),
        ("5&3&2&", DEPTH, "a.bin has 2 channels; expected one, of depth.$"),
        ("0&3&1&", DEPTH, "a.bin has 0x3 px; expected at least one"),
        ("5&4&1&", DEPTH, "a.bin is truncated: expected 80 bytes for 5x4 values, found 60"),
        ("999999999&999999999&1&", DEPTH, "a.bin is truncated: expected 3999999992000000004 by"),
        ("5&2&1&", DEPTH, "a.bin has bytes to spare: expected 40 bytes for 5x2 values, found 60"),
        (
            None,
            np.where(DEPTH == 0, np.nan, DEPTH),
            r"holds nan at row 1, column 2 \(1 such values",
        ),
        (None, -DEPTH, "expected distances, finite and at least 0"),
    ],
)
def test_what_is_no_depth_map_is_refused(tmp_path, header, depth, message):
    with pytest.raises(ValueError, match=message):
        read_colmap_depth(written(tmp_path / "a.bin", depth, header))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a.bin is not there; expected a depth map of CO"):
        read_colmap_depth(tmp_path / "a.bin")
