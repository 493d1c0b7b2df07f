"""Single image files: what people's cameras and tools append to them, turn in them, or damage."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from mvedge_jax.datasets._images import (
    image_orientation,
    image_size,
    read_cutout,
    read_image,
    read_raw,
)
from mvedge_jax.datasets._png import SIGNATURE

RANDOM = np.random.default_rng(0)
# Smooth, so that a JPEG keeps it; and different in each of its corners.
SMOOTH = cv2.resize(RANDOM.integers(0, 255, (3, 4, 3), dtype=np.uint8), (24, 16))


def jpeg(image=SMOOTH, orientation=None, **options) -> bytes:
    stream, exif = io.BytesIO(), Image.Exif()
    if orientation is not None:
        exif[0x112] = orientation
    Image.fromarray(image).save(stream, "JPEG", quality=98, exif=exif, **options)
    return stream.getvalue()


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize(
    "trailer",
    [
        b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 20,  # a video
        b"\0\0\x01\x0aImage_UTC_Data1700000000000SEFT",  # of a maker
        bytes(500),
        b"\n",
        jpeg(255 - SMOOTH),
    ],
    ids=["video", "maker", "zeros", "one byte", "another image"],
)
def test_a_jpeg_with_bytes_behind_its_end_is_complete(tmp_path, trailer, progressive):
    plain, longer = tmp_path / "plain.jpg", tmp_path / "longer.jpg"
    plain.write_bytes(jpeg(progressive=progressive))
    longer.write_bytes(plain.read_bytes() + trailer)
    assert_array_equal(read_raw(longer), read_raw(plain))
    assert image_size(longer) == (16, 24)
    assert np.abs(read_image(longer).astype(int) - SMOOTH).mean() < 3


def test_of_several_images_in_a_jpeg_the_first_is_read(tmp_path):
    path = tmp_path / "pair.jpg"
    first, second = Image.fromarray(SMOOTH), Image.fromarray(255 - SMOOTH)
    first.save(path, "MPO", save_all=True, append_images=[second], quality=98)
    with Image.open(path) as both:
        assert both.format == "MPO"
    assert np.abs(read_image(path).astype(int) - SMOOTH).mean() < 3


@pytest.mark.parametrize("ending", [b"", bytes(3000), b"\r\n"])
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_a_truncated_jpeg_is_named_whatever_fills_it_up(tmp_path, share, ending):
    data, path = jpeg(RANDOM.integers(0, 255, (64, 64, 3), dtype=np.uint8)), tmp_path / "cut.jpg"
    path.write_bytes(data[: int(share * len(data))] + ending)
    with pytest.raises(ValueError, match=r"cut\.jpg cannot be read: it is truncated \(a JPEG\)"):
        read_raw(path)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientations_are_applied_as_opencv_applies_them(tmp_path, orientation):
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg(orientation=orientation))
    assert image_orientation(path) == orientation
    wanted = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert wanted is not None
    assert_allclose(read_raw(path), wanted, atol=3)
    assert image_size(path) == wanted.shape[:2]
    stored = read_image(path, upright=False)
    assert np.abs(stored.astype(int) - SMOOTH).mean() < 3
    assert image_size(path, upright=False) == stored.shape[:2]


@pytest.mark.parametrize("value", [0, 9, 60000])
def test_orientations_that_there_are_not_turn_nothing(tmp_path, value):
    path, whole = tmp_path / "odd.jpg", jpeg(orientation=value)
    path.write_bytes(whole)
    assert image_orientation(path) == 1
    # Nor do EXIF data that are damaged, within their segment.
    start = whole.index(b"Exif") + 6
    for place in range(start, start + 26):
        data = bytearray(whole)
        data[place] ^= 0xFF
        path.write_bytes(bytes(data))
        assert read_raw(path).shape == (16, 24, 3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_cutouts_tell_what_is_opaque(tmp_path, dtype):
    most, path = np.iinfo(dtype).max, tmp_path / "cut.png"
    whole = np.full((4, 5, 4), most, dtype)
    cut, none = whole.copy(), whole.copy()
    cut[:2, :, 3], cut[2, 0, 3], none[..., 3] = 0, most // 4, 0
    cv2.imwrite(str(path), whole)
    assert read_cutout(path)[1] is None
    cv2.imwrite(str(path), cut)
    assert_array_equal(read_cutout(path)[1], cut[..., 3] > most // 2)
    cv2.imwrite(str(path), none)
    with pytest.raises(ValueError, match=r"cut\.png is transparent everywhere"):
        read_cutout(path)
    (tmp_path / "plain.jpg").write_bytes(jpeg())
    assert read_cutout(tmp_path / "plain.jpg")[1] is None


def chunk(kind: bytes, body: bytes) -> bytes:
    check = struct.pack(">I", zlib.crc32(kind + body))
    return struct.pack(">I", len(body)) + kind + body + check


def png(
    *,
    size=(5, 7),
    depth=8,
    color=2,
    interlace=0,
    pixels: bytes = bytes(5 * 22),
    between: bytes = b"",
    stream: bytes | None = None,
) -> bytes:
    head = struct.pack(">IIBBBBB", size[1], size[0], depth, color, 0, 0, interlace)
    packed = zlib.compress(pixels) if stream is None else stream
    chunks = [chunk(b"IHDR", head), between, chunk(b"IDAT", packed), chunk(b"IEND", b"")]
    return SIGNATURE + b"".join(chunks)


KINDS = [(0, 1), (0, 4), (0, 8), (0, 16), (2, 8), (2, 16), (3, 1), (3, 8), (4, 8), (6, 8), (6, 16)]
# Of every pass: its first pixel, and its strides.
PASSES = [
    [(0, 0, 1, 1)],
    [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2),
     (0, 1, 1, 2)],
]  # fmt: skip


@pytest.mark.parametrize(("color", "depth"), KINDS)
@pytest.mark.parametrize("interlace", [0, 1])
def test_every_kind_of_png_is_read_as_opencv_reads_it(tmp_path, capfd, color, depth, interlace):
    bits, rows = depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color], b""
    for x, y, across, down in PASSES[interlace]:
        length = (len(range(x, 7, across)) * bits + 7) // 8
        for _ in range(y, 5, down) if length else ():
            rows += b"\0" + RANDOM.integers(0, 256, length, dtype=np.uint8).tobytes()
    palette = chunk(b"PLTE", RANDOM.integers(0, 256, 3 << min(depth, 8), dtype=np.uint8).tobytes())
    between = palette + chunk(b"tRNS", b"\x40\x80") if color == 3 else b""
    data = png(depth=depth, color=color, interlace=interlace, pixels=rows, between=between)
    (tmp_path / "kind.png").write_bytes(data)
    wanted = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert wanted is not None
    assert_array_equal(read_raw(tmp_path / "kind.png"), wanted)
    assert not capfd.readouterr().err


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (png(stream=b"no deflate"), "pixels cannot be inflated"),
        (png(pixels=bytes(50)), "with 50 of 110 bytes of pixels"),
        (png(stream=b""), "too few bytes for 110 bytes of pixels|with 0 of 110"),
        (png(size=(100_000, 100_000)), "too few bytes"),
        (png(size=(1, 2_000_000)), "beyond the 1000000 px a side"),
        (png(pixels=b"\x09" * 110), "unknown filter"),
        (png(color=5), "no known kind of pixels"),
        (png(depth=3), "no known kind of pixels"),
        (png(color=3, pixels=bytes(40)), "without its palette"),
        (png(between=chunk(b"CgBI", b"1234")), "unknown critical chunk"),
        (SIGNATURE + chunk(b"IHDR", bytes(3)) + chunk(b"IEND", b""), "without its header"),
    ],
)
def test_damaged_pngs_are_named_and_libpng_is_silent(tmp_path, capfd, data, message):
    (tmp_path / "bad.png").write_bytes(data)
    with pytest.raises(ValueError, match=rf"bad\.png cannot be read: .*({message})"):
        read_raw(tmp_path / "bad.png")
    assert not capfd.readouterr().err


def test_what_libpng_warns_of_is_left_out(tmp_path, capfd):
    profile = chunk(b"iCCP", b"odd\0\0" + zlib.compress(bytes(20)))
    text = chunk(b"tEXt", b"no separator") + chunk(b"gAMA", b"1") + chunk(b"tRNS", b"12345678")
    path = tmp_path / "odd.png"
    path.write_bytes(png(between=profile + text, pixels=bytes(110) + b"more than enough") + b"end")
    assert read_raw(path).shape == (5, 7, 3)
    assert not capfd.readouterr().err
