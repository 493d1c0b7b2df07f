"""Checks PNG files and reduces them to their pixels, so that libpng prints no messages."""

import struct
import zlib
from collections.abc import Iterator

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Of every color type: samples per pixel, and the bit depths that it may have.
_KINDS = {
    0: (1, (1, 2, 4, 8, 16)),
    2: (3, (8, 16)),
    3: (1, (1, 2, 4, 8)),
    4: (2, (8, 16)),
    6: (4, (8, 16)),
}
_GRAY, _RGB, _PALETTE = 0, 2, 3
# Of every pass of Adam7: first column and row, and steps.
_ADAM7 = (
    (0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4),
    (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2),
)  # fmt: skip
# libpng refuses longer sides, and a chunk holds less than 2 GiB.
_LONGEST, _CHUNK = 1_000_000, 2**30
# Largest expansion factor of deflate.
_DEFLATED = 1032


class DamagedPng(ValueError):
    """Damage of a PNG file, as a clause: `it is truncated at byte 5 (a PNG)`."""


def plain_png(data: bytes) -> bytes:
    """Reduces a PNG file to its pixels, uncompressed, or raises `DamagedPng`.

    OpenCV's libpng prints messages about profiles and damage to the standard error. To avoid them,
    chunks that do not change pixels are dropped, checksums, sizes and filters are checked, and the
    pixels are inflated here, once.
    """
    kept: dict[bytes, list[bytes]] = {}
    for position, kind, body in _chunks(data):
        if kind[:1].isupper() and kind not in (b"IHDR", b"PLTE", b"IDAT", b"IEND"):
            raise DamagedPng(f"it has an unknown critical chunk at byte {position} (a PNG)")
        kept.setdefault(kind, []).append(body)
    head = kept.get(b"IHDR", [b""])[0]
    depth, color, passes = _header(head)
    pixels = _inflated(b"".join(kept.get(b"IDAT", [])), passes)
    parts = [SIGNATURE, _chunk(b"IHDR", head)]
    palette = kept.get(b"PLTE", [b""])[0]
    if color == _PALETTE:
        if not palette or len(palette) % 3:
            raise DamagedPng("it is damaged (a PNG without its palette)")
        palette = palette[: 3 << depth]
        parts.append(_chunk(b"PLTE", palette))
    clear = kept.get(b"tRNS", [b""])[0]
    if color == _PALETTE:
        clear = clear[: len(palette) // 3]
    elif len(clear) != {_GRAY: 2, _RGB: 6}.get(color):
        clear = b""
    if clear:
        parts.append(_chunk(b"tRNS", clear))
    stored = zlib.compress(pixels, 0)
    parts += [_chunk(b"IDAT", stored[i : i + _CHUNK]) for i in range(0, len(stored), _CHUNK)]
    return b"".join([*parts, _chunk(b"IEND", b"")])


def _chunk(kind: bytes, body: bytes) -> bytes:
    length, check = len(body), zlib.crc32(body, zlib.crc32(kind))
    return struct.pack(">I", length) + kind + body + struct.pack(">I", check)


def _chunks(data: bytes) -> Iterator[tuple[int, bytes, bytes]]:
    """Place, kind and content of every chunk up to the end."""
    position = len(SIGNATURE)
    while position + 12 <= len(data):
        length = struct.unpack(">I", data[position : position + 4])[0]
        end = position + 12 + length
        if end > len(data):
            raise DamagedPng(f"it is truncated at byte {len(data)} (a PNG)")
        chunk = memoryview(data)[position + 4 : end - 4]
        if zlib.crc32(chunk) != struct.unpack(">I", data[end - 4 : end])[0]:
            raise DamagedPng(f"it is damaged at byte {position} (a PNG checksum is wrong)")
        kind = bytes(chunk[:4])
        yield position, kind, bytes(chunk[4:])
        if kind == b"IEND":
            return
        position = end
    raise DamagedPng(f"it is truncated at byte {len(data)} (a PNG without its end)")


def _header(head: bytes) -> tuple[int, int, list[tuple[int, int]]]:
    """Bit depth and color type; of every pass, its rows and the bytes of each."""
    if len(head) != 13:
        raise DamagedPng("it is damaged (a PNG without its header)")
    width, height, depth, color, method, filters, interlace = struct.unpack(">IIBBBBB", head)
    samples, depths = _KINDS.get(color, (0, ()))
    if depth not in depths or method or filters or interlace > 1:
        raise DamagedPng("it is damaged (a PNG of no known kind of pixels)")
    if not 0 < min(width, height) <= max(width, height) <= _LONGEST:
        raise DamagedPng(f"it is {width}x{height} px, beyond the {_LONGEST} px a side of libpng")
    sizes = [(height, width)]
    if interlace:
        sizes = [
            (-(-(height - y) // down), -(-(width - x) // across)) for x, y, across, down in _ADAM7
        ]
    # A row begins with the number of its filter.
    bits = samples * depth
    return depth, color, [(rows, 1 + -(-side * bits // 8)) for rows, side in sizes if side > 0]


def _inflated(stream: bytes, passes: list[tuple[int, int]]) -> bytes:
    """The filtered rows of all passes."""
    need = sum(rows * length for rows, length in passes)
    if need > _DEFLATED * (len(stream) + 1):
        raise DamagedPng(f"it is damaged (a PNG with too few bytes for {need} bytes of pixels)")
    try:
        pixels = zlib.decompressobj().decompress(stream, need)
    except zlib.error as fault:
        raise DamagedPng("it is damaged (a PNG whose pixels cannot be inflated)") from fault
    if len(pixels) < need:
        raise DamagedPng(f"it is damaged (a PNG with {len(pixels)} of {need} bytes of pixels)")
    table, start = np.frombuffer(pixels, np.uint8), 0
    for rows, length in passes:
        if rows and table[start : start + rows * length : length].max() > 4:
            raise DamagedPng("it is damaged (a PNG with an unknown filter)")
        start += rows * length
    return pixels
