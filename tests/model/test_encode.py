"""Depth maps in few bytes: what comes back, how large files are, which are refused."""

import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.model import _format
from mvedge_jax.model.codec import Encoding, decode, encode


def depth_map(shape=(19, 23)):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    smooth = 0.3 * np.sin(x / 7) * np.cos(y / 6)
    return jnp.asarray(np.where((x - 11) ** 2 + (y - 9) ** 2 < 25, smooth + 1.5, smooth))


@pytest.fixture(scope="module")
def encoding():
    return encode(depth_map(), 40, iterations=0, bits=9)


def test_a_file_gives_back_the_same(encoding, tmp_path):
    path = tmp_path / "code.mvec"
    assert encoding.save(path) == path.stat().st_size < 200  # of 437 pixels
    again = Encoding.load(path)
    for a, b in zip(jax.tree.leaves(encoding), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(decode(encoding), decode(again))


def test_flat_maps_and_bad_input(tmp_path, monkeypatch):
    flat = jnp.full((5, 6), 0.25)
    found = encode(flat, 1, iterations=0)
    np.testing.assert_allclose(decode(found), 0.25, atol=1e-9)
    with pytest.raises(ValueError, match="`k` must be from 1 to the 30 pixels there are, got 31"):
        encode(flat, 31)
    with pytest.raises(ValueError, match="`disparity` must be finite"):
        encode(flat.at[0, 0].set(jnp.nan), 3)
    with pytest.raises(FileNotFoundError, match="no encoding at"):
        Encoding.load(tmp_path / "none.mvec")
    with pytest.raises(ValueError, match="`bits` must be from 1 to 16, got 17"):
        encode(flat, 1, bits=17)
    monkeypatch.setitem(sys.modules, "constriction", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'mvedge_jax\[codec\]'"):
        found.save(tmp_path / "code.mvec")
    assert not (tmp_path / "code.mvec").exists()


def packed(parts, likely):
    content = _format.pack(parts, likely)
    assert content[:5] == b"MVEC\x01"
    return content


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (13, 40)])
@pytest.mark.parametrize("bits", [1, 16])
def test_any_cuts_points_and_labels_come_back(shape, bits):
    draw = np.random.default_rng(bits)
    for share in (0.0, 0.2, 1.0):
        cut, point, likely = (draw.random((3, *shape)) < share) | (np.zeros((3, *shape), bool))
        label = draw.integers(0, 2**bits, int(point.sum()))
        parts = _format.Parts(cut, point, label, bits, (-1.5, 2.0))
        again = _format.unpack(packed(parts, likely), lambda *_, likely=likely: likely)
        for a, b in zip(parts, again, strict=True):
            np.testing.assert_array_equal(a, b)


def test_files_that_are_no_encoding_are_refused(encoding, tmp_path):
    bad = tmp_path / "bad.mvec"
    encoding.save(bad)
    whole = bad.read_bytes()
    flipped = bytearray(whole)
    flipped[-9] ^= 255
    newer = whole[:4] + bytes([2]) + whole[5:]

    def claiming(**change):
        names = ("magic", "version", "bits", "height", "width", "count", "low", "high", "check")
        fields = dict(zip(names, _format._HEADER.unpack_from(whole), strict=True)) | change
        return _format._HEADER.pack(*fields.values()) + whole[_format._HEADER.size :]

    for content, message in (
        (b"", "it starts with b''"),
        (b"text", "it starts with b'text'"),
        (whole[:20], "expected b'MVEC' and a header"),
        (newer, "its format has version 2, expected 1"),
        (whole[:-4], "its checksum does not agree"),
        (bytes(flipped), "its checksum does not agree"),
        (claiming(height=0), "it claims 0x23 px"),
        (claiming(height=1 << 30, width=1 << 30), "it claims 1073741824x1073741824 px"),
        (claiming(bits=17), "17 bits a label"),
        (claiming(count=500), "500 points"),
        (claiming(count=41), "it claims 41 points, and has"),
        (claiming(low=float("nan")), "its range is nan to"),
        (claiming(low=1e9), "expected finite numbers in order"),
    ):
        bad.write_bytes(content)
        what = r"bad.mvec is not an encoding that was saved: "
        with pytest.raises(ValueError, match=f"{what}.*{re.escape(message)}"):
            Encoding.load(bad)
