"""Maps in files: PFM against OpenCV, depth maps of COLMAP by the letter of its description."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from experiments.peers.photographs import read_colmap_depth
from mvedge_jax.datasets import read_pfm, write_pfm

VALUES = np.array([[1, 2], [3, 4]], np.float32)
DEPTH = np.random.default_rng(0).uniform(0.5, 9, (3, 5)).astype(np.float32)
DEPTH[1, 2] = 0


def test_a_pfm_keeps_every_value_as_opencv_does(tmp_path):
    values = np.random.default_rng(0).normal(size=(5, 7)).astype(np.float32)
    # The first byte after the header's single blank may itself be a blank's code.
    values[0, 0], values[1, 2], values[-1, :2] = (
        np.nan,
        np.inf,
        np.frombuffer(b"\n\n\n\n ab ", "<f4"),
    )
    ours, theirs = tmp_path / "ours.pfm", tmp_path / "theirs.pfm"
    write_pfm(ours, values)
    assert cv2.imwrite(str(theirs), values)
    for found in (read_pfm(ours), cv2.imread(str(ours), -1), read_pfm(theirs)):
        assert_array_equal(found, values)
    with pytest.raises(ValueError, match=r"two axes \[y, x\]"):
        write_pfm(ours, np.zeros((2, 0)))


@pytest.mark.parametrize(
    "header",
    [
        "Pf\n2 2\n-1.0\n",
        "Pf\r\n2 2\r\n-1.0\r\n",
        "Pf \n2 2 \t\n-1.0  \n",
        "Pf \r\n2 2 \r\n-1.0 \r\n",
        "Pf\n# made by hand\n2 2\n# little endian\n-1\n",
        "Pf # made by hand\r\n2 2\r\n-1\r\n",
        "Pf 2 2 -1 ",
        "Pf\n2\n2\n-1e0\n",
        "Pf\r2 2\r-1\r",
    ],
)
def test_headers_as_other_tools_write_them(tmp_path, header):
    """Rows are stored bottom up; the sign of the scale is the order of the bytes."""
    file = tmp_path / "a.pfm"
    for text, order in ((header, "<f4"), (header.replace("-1", "1"), ">f4")):
        file.write_bytes(text.encode() + VALUES[::-1].astype(order).tobytes())
        assert_array_equal(read_pfm(file), VALUES)


@pytest.mark.parametrize("scale", [-2.0, 0.5, -0.25])
def test_values_are_divided_by_the_scale_as_opencv_divides_them(tmp_path, scale):
    file, order = tmp_path / "a.pfm", "<f4" if scale < 0 else ">f4"
    file.write_bytes(f"Pf\n2 2\n{scale}\n".encode() + VALUES[::-1].astype(order).tobytes())
    with pytest.warns(UserWarning, match=r"a\.pfm has the scale .*; its values were divided by it"):
        found = read_pfm(file)
    assert_array_equal(found, VALUES / abs(scale))
    assert_array_equal(found, cv2.imread(str(file), cv2.IMREAD_UNCHANGED))


def test_middleburys_scale_changes_no_value(tmp_path):
    (tmp_path / "a.pfm").write_bytes(b"Pf\n2 2\n-0.003922\n" + VALUES[::-1].tobytes())
    with pytest.warns(UserWarning, match="as Middlebury's files have; its values were read as"):
        assert_array_equal(read_pfm(tmp_path / "a.pfm"), VALUES)


def colmap(depth=DEPTH, header="5&3&1&"):
    """As COLMAP's `Mat::Write`: columns run fastest, then rows, then channels; little-endian."""
    numbers = [depth[y, x] for y in range(depth.shape[0]) for x in range(depth.shape[1])]
    return header.encode() + np.asarray(numbers, "<f4").tobytes()


def test_a_map_of_colmap_comes_back(tmp_path):
    file = tmp_path / "a.png.geometric.bin"
    file.write_bytes(colmap())
    found = read_colmap_depth(file)
    assert found.dtype == np.float32
    assert_array_equal(found, DEPTH)
    # The script that COLMAP ships for this format reads it in Fortran's order, and turns it.
    data = file.read_bytes().split(b"&", 3)[3]
    theirs = np.frombuffer(data, np.float32).reshape((5, 3, 1), order="F").transpose(1, 0, 2)
    assert_array_equal(found, theirs[..., 0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.pfm", None, r"a\.pfm is not there"),
        ("a.pfm", b"P6\n1 1\n255\nabc", "expected it to begin with 'Pf'"),
        ("a.pfm", b"", "expected it to begin with 'Pf'"),
        ("a.pfm", b"PF\n1 1\n-1\n" + bytes(12), "three channels"),
        ("a.pfm", b"Pf\n2 2\n-1\n" + bytes(15), "expected 16 bytes for 2x2 values, found 15"),
        ("a.pfm", b"Pf\r\n2 2\r\n-1\r\n" + bytes(15), "expected 16 bytes for 2x2 .* found 15"),
        ("a.pfm", b"Pf\n2 2\n-1\n" + bytes(17), "bytes to spare: expected 16 bytes .* found 17"),
        ("a.pfm", b"Pf\n#2 2\n-1\n" + bytes(16), "broken header"),
        ("a.pfm", b"Pf\n2 two\n-1\n" + bytes(16), "broken header"),
        ("a.pfm", b"Pf\n2\n", "broken header"),
        ("a.pfm", b"Pf\n2 2\n0\n" + bytes(16), "broken header"),
        ("a.bin", None, "is not there; expected a depth map of CO"),
        ("a.bin", colmap(header="5x3x1x"), "no.*COLMAP: expected it to begin with 'width&"),
        ("a.bin", colmap(header="5&3&3&"), "has 3 channels; .* depth; three are a map of norm"),
        ("a.bin", colmap(header="5&3&2&"), "has 2 channels; expected one, of depth.$"),
        ("a.bin", colmap(header="0&3&1&"), "has 0x3 px; expected at least one"),
        ("a.bin", colmap(header="5&4&1&"), "truncated: expected 80 bytes for 5x4 .* found 60"),
        ("a.bin", colmap(header=2 * "999999999&" + "1&"), "expected 3999999992000000004 by"),
        ("a.bin", colmap(header="5&2&1&"), "bytes to spare: expected 40 bytes .* found 60"),
        ("a.bin", colmap(np.where(DEPTH, DEPTH, np.nan)), r"nan at row 1, column 2 \(1 such val"),
        ("a.bin", colmap(-DEPTH), "expected distances, finite and at least 0"),
    ],
)
def test_broken_files_are_named(tmp_path, name, content, message):
    read, path = {"a.pfm": read_pfm, "a.bin": read_colmap_depth}[name], tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(FileNotFoundError if content is None else ValueError, match=message) as said:
        read(path)
    assert name in str(said.value)
