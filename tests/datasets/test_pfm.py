import cv2
import numpy as np
import pytest

from mvedge_jax.datasets import read_pfm, write_pfm


def test_round_trip_keeps_every_bit(tmp_path):
    values = np.random.default_rng(0).normal(size=(5, 7)).astype(np.float32)
    values[0, 0], values[1, 2] = np.nan, np.inf
    write_pfm(tmp_path / "a.pfm", values)
    assert np.array_equal(read_pfm(tmp_path / "a.pfm"), values, equal_nan=True)


def test_opencv_reads_and_writes_the_same(tmp_path):
    values = np.random.default_rng(0).normal(size=(3, 4)).astype(np.float32)
    write_pfm(tmp_path / "ours.pfm", values)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "ours.pfm"), -1), values)
    assert cv2.imwrite(str(tmp_path / "theirs.pfm"), values)
    np.testing.assert_array_equal(read_pfm(tmp_path / "theirs.pfm"), values)


def test_rows_are_stored_bottom_up_and_either_byte_order_is_read(tmp_path):
    big = b"Pf\n2 2\n1.0\n" + np.array([3, 4, 1, 2], ">f4").tobytes()
    (tmp_path / "big.pfm").write_bytes(big)
    np.testing.assert_array_equal(read_pfm(tmp_path / "big.pfm"), [[1, 2], [3, 4]])


def test_a_value_that_looks_like_a_blank_is_not_skipped(tmp_path):
    # The first byte after the header's single blank may itself be a blank's code.
    values = np.frombuffer(b"\n\n\n\n ab ", "<f4").reshape(1, 2)
    write_pfm(tmp_path / "a.pfm", values)
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), values)


VALUES = np.array([[1, 2], [3, 4]], np.float32)


@pytest.mark.parametrize(
    "header",
    [
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
    stored = np.ascontiguousarray(VALUES[::-1])
    (tmp_path / "a.pfm").write_bytes(header.encode() + stored.astype("<f4").tobytes())
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), VALUES)
    big = header.replace("-1", "1").encode() + stored.astype(">f4").tobytes()
    (tmp_path / "b.pfm").write_bytes(big)
    np.testing.assert_array_equal(read_pfm(tmp_path / "b.pfm"), VALUES)


@pytest.mark.parametrize("scale", [-2.0, 0.5, -0.25])
def test_values_are_divided_by_the_scale_as_opencv_divides_them(tmp_path, scale):
    order = "<f4" if scale < 0 else ">f4"
    file = tmp_path / "a.pfm"
    file.write_bytes(f"Pf\n2 2\n{scale}\n".encode() + VALUES[::-1].astype(order).tobytes())
    with pytest.warns(UserWarning, match=r"a\.pfm has the scale .*; its values were divided by it"):
        found = read_pfm(file)
    np.testing.assert_array_equal(found, VALUES / abs(scale))
    np.testing.assert_array_equal(found, cv2.imread(str(file), cv2.IMREAD_UNCHANGED))


def test_middleburys_scale_changes_no_value(tmp_path):
    (tmp_path / "a.pfm").write_bytes(b"Pf\n2 2\n-0.003922\n" + VALUES[::-1].tobytes())
    with pytest.warns(UserWarning, match="as Middlebury's files have; its values were read as"):
        np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm"), VALUES)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"P6\n1 1\n255\nabc", "expected it to begin with 'Pf'"),
        (b"", "expected it to begin with 'Pf'"),
        (b"PF\n1 1\n-1\n" + bytes(12), "three channels"),
        (b"Pf\n2 2\n-1\n" + bytes(15), "expected 16 bytes for 2x2 values, found 15"),
        (b"Pf\r\n2 2\r\n-1\r\n" + bytes(15), "expected 16 bytes for 2x2 values, found 15"),
        (b"Pf\n2 2\n-1\n" + bytes(17), "bytes to spare: expected 16 bytes .* found 17"),
        (b"Pf\n#2 2\n-1\n" + bytes(16), "broken header"),
        (b"Pf\n2 two\n-1\n" + bytes(16), "broken header"),
        (b"Pf\n2\n", "broken header"),
        (b"Pf\n2 2\n0\n" + bytes(16), "broken header"),
    ],
)
def test_broken_files_are_named(tmp_path, content, text):
    (tmp_path / "bad.pfm").write_bytes(content)
    with pytest.raises(ValueError, match=text) as caught:
        read_pfm(tmp_path / "bad.pfm")
    assert "bad.pfm" in str(caught.value)


def test_missing_file_and_wrong_shape(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.pfm is not there"):
        read_pfm(tmp_path / "none.pfm")
    with pytest.raises(ValueError, match=r"two axes \[y, x\]"):
        write_pfm(tmp_path / "a.pfm", np.zeros((2, 0)))
