from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mvedge_jax.model.codec import Encoding, decode, encode


def depth_map(shape=(19, 23)):
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    smooth = 0.3 * np.sin(x / 7) * np.cos(y / 6)
    return jnp.asarray(np.where((x - 11) ** 2 + (y - 9) ** 2 < 25, smooth + 1.5, smooth))


@pytest.mark.slow
def test_more_points_reproduce_better_and_enough_nearly_perfectly(tmp_path):
    truth = depth_map()
    errors, sizes = [], []
    for k in (12, 60, 300):
        encoding = encode(truth, k, iterations=8)
        assert encoding.pixel.shape == (k,)
        errors.append(float(jnp.sqrt(jnp.mean((decode(encoding) - truth) ** 2))))
        sizes.append(encoding.save(tmp_path / "code.npz"))
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
    assert errors[2] < 2e-3
    assert sizes == sorted(sizes)


def test_a_file_gives_back_the_same(tmp_path):
    encoding = encode(depth_map(), 40, iterations=0)
    path = tmp_path / "code.npz"
    assert encoding.save(path) == path.stat().st_size
    again = Encoding.load(path)
    for a, b in zip(jax.tree.leaves(encoding), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(decode(encoding), decode(again))


def test_flat_maps_and_bad_input(tmp_path):
    flat = jnp.full((5, 6), 0.25)
    np.testing.assert_allclose(decode(encode(flat, 1, iterations=0)), 0.25, atol=1e-9)
    with pytest.raises(ValueError, match="`k` must be from 1 to the 30 pixels there are, got 31"):
        encode(flat, 31)
    with pytest.raises(ValueError, match="`disparity` must be finite"):
        encode(flat.at[0, 0].set(jnp.nan), 3)
    with pytest.raises(FileNotFoundError, match="no encoding at"):
        Encoding.load(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(2))
    with pytest.raises(ValueError, match=r"has the arrays \['a'\]"):
        Encoding.load(tmp_path / "other.npz")


def test_files_that_are_no_encoding_are_refused(tmp_path):
    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    encode(depth_map(), 40, iterations=0).save(good)
    whole = good.read_bytes()
    np.save(tmp_path / "array.npy", np.zeros(3))
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 255
    array = (tmp_path / "array.npy").read_bytes()
    for content in (b"", b"text", array, whole[:-40], bytes(flipped)):
        bad.write_bytes(content)
        with pytest.raises(ValueError, match=r"bad.npz is not an encoding that was saved: "):
            Encoding.load(bad)
    with np.load(good) as file:
        parts = dict(file)
    for change, message in (
        ({"shape": np.asarray([2, 3], np.int32)}, "claims 2x3 px"),
        ({"high_bytes": parts["high_bytes"][:2], "low_bytes": parts["low_bytes"][:2]}, "2 labels"),
        ({"range": np.asarray([0.0, np.nan])}, "its range is 0.0 to nan"),
        ({"range": np.asarray([0, 1])}, "its range is 0 to 1"),
    ):
        changed: dict[str, Any] = parts | change
        np.savez(bad, **changed)
        with pytest.raises(ValueError, match=message):
            Encoding.load(bad)
