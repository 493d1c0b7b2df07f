"""Checks of the sizes in a MATLAB file before SciPy reads it."""

import struct
import zlib
from pathlib import Path

_COMPRESSED, _MATRIX = 15, 14
_HEADER = 128
# Type, flags, dimensions and name of a variable lie within so many bytes of its beginning.
_HEAD = 4096


def check_elements(path: Path, limit: float) -> None:
    """Refuses a version 5 file whose elements claim more than there is, or than `limit` bytes.

    SciPy allocates memory by the stated length and unpacks compressed data into it: four megabytes
    can claim four gigabytes.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        order = {b"IM": "<", b"MI": ">"}.get(stream.read(_HEADER)[126:])
        if order is None:
            raise ValueError(
                f"{path} cannot be read as a MATLAB file (truncated or of another format): it does "
                "not begin as one of version 5 or later."
            )
        position = _HEADER
        while position < size:
            stream.seek(position)
            tag = stream.read(8)
            if len(tag) < 8:
                break
            kind, length = struct.unpack(order + "II", tag)
            if position + 8 + length > size:
                raise ValueError(
                    f"{path} cannot be read as a MATLAB file: it is truncated, an element of "
                    f"{length} bytes begins at byte {position} of {size}."
                )
            head = stream.read(min(length, _HEAD))
            if kind == _COMPRESSED:
                try:
                    head = zlib.decompressobj().decompress(head, _HEAD)
                except zlib.error as error:
                    raise ValueError(
                        f"{path} cannot be read as a MATLAB file: it is damaged at byte "
                        f"{position} ({error})."
                    ) from error
                kind, head = struct.unpack(order + "I", head[:4])[0] if head[4:] else 0, head[8:]
            if kind == _MATRIX:
                _check_parts(path, order, head, limit)
            position += 8 + length


def _check_parts(path: Path, order: str, head: bytes, limit: float) -> None:
    """The lengths of flags, dimensions and name, which are short, and of the numbers."""
    position = 0
    for part in range(4):
        if position + 8 > len(head):
            return
        first, length = struct.unpack_from(order + "II", head, position)
        if first >> 16:  # a small element: length and content in the tag
            position += 8
            continue
        allowed = limit if part == 3 else _HEAD
        if length > allowed:
            raise ValueError(
                f"{path} claims {length / 1e9:,.3g} GB for a part of a variable; expected at most "
                f"{allowed / 1e9:g} GB."
            )
        position += 8 + length + -length % 8
