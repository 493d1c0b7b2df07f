"""The file of an encoding: cuts, places and labels by one adaptive range coder."""

import struct
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

MAGIC, VERSION = b"MVEC", 1
# Magic, version, bits of a label, height, width, points, range, checksum of what follows.
_HEADER = struct.Struct("<4sBBIIIddI")
# Probabilities are multiples of one part in so many: whole numbers are the same everywhere.
_PARTS = 4096
# Counts are halved above this, so that what was long ago counts less.
_FORGET = 4000
# More pixels than any map has: a file that claims them is damaged.
_MOST_PIXELS = 1 << 28


class Parts(NamedTuple):
    """What a file holds.

    Attributes:
        cut: `[y, x]`.
        point: where points are, `[y, x]`.
        label: of each point, row by row.
        bits: of a label.
        ends: labels of 0 and of `2**bits - 1`.
    """

    cut: np.ndarray
    point: np.ndarray
    label: np.ndarray
    bits: int
    ends: tuple[float, float]


class _Bits:
    """Codes bits, each in a context whose share of ones is learned on the way.

    Called with a bit it writes, with None it reads; either way it returns the bit, so that one walk
    through the data serves both directions.
    """

    def __init__(self, words: np.ndarray | None = None):
        coder = _constriction().stream
        self._queue: Any = (
            coder.queue.RangeEncoder() if words is None else coder.queue.RangeDecoder(words)
        )
        self._code: Callable[..., Any] = self._queue.encode if words is None else self._queue.decode
        shares = range(1, _PARTS)
        self._models = [None, *(coder.model.Bernoulli(k / _PARTS, perfect=False) for k in shares)]
        self._counts: dict[Any, list[int]] = {}

    def __call__(self, context: Any, bit: int | None) -> int:
        # Two of five: what was seen once is soon believed (Krichevsky and Trofimov).
        counts = self._counts.setdefault(context, [2, 2])
        zeros, ones = counts
        model = self._models[min(max(_PARTS * ones // (zeros + ones), 1), _PARTS - 1)]
        if bit is None:
            read: int = self._code(model)
        else:
            read = bit
            self._code(bit, model)
        counts[read] += 5
        if zeros + ones > _FORGET:
            counts[:] = zeros // 2 + 1, ones // 2 + 1
        return read

    def words(self) -> np.ndarray:
        """What was written."""
        return self._queue.get_compressed()


def _constriction() -> Any:
    try:
        import constriction
    except ModuleNotFoundError as missing:
        raise ModuleNotFoundError(
            "files of encodings need constriction: pip install 'mvedge_jax[codec]'."
        ) from missing
    return constriction


def pack(parts: Parts, first: np.ndarray) -> bytes:
    """The bytes of a file.

    Args:
        parts: see `Parts`.
        first: where points are likely, `[y, x]`: those of a grid that follows from their number.

    Returns:
        Header and code.
    """
    bits = _Bits()
    _bitmap(bits, np.zeros_like(parts.cut, np.int64), parts.cut)
    _bitmap(bits, _around(parts.cut, first), parts.point)
    _labels(bits, parts.point, parts.cut, parts.bits, parts.label)
    words = bits.words().astype("<u4").tobytes()
    height, width = parts.cut.shape
    count = len(parts.label)
    head = (MAGIC, VERSION, parts.bits, height, width, count, *parts.ends, zlib.crc32(words))
    return _HEADER.pack(*head) + words


def unpack(content: bytes, first: Callable[[int, int, int], np.ndarray]) -> Parts:
    """What `pack` packed.

    Args:
        content: of a file.
        first: makes the likely places of so many rows, columns and points.

    Returns:
        Its parts.

    Raises:
        ValueError: it is no such file, of another version, or damaged.
    """
    if content[:4] != MAGIC or len(content) < _HEADER.size:
        raise ValueError(f"it starts with {content[:4]!r}, expected {MAGIC!r} and a header")
    _, version, depth, height, width, count, low, high, check = _HEADER.unpack_from(content)
    if version != VERSION:
        raise ValueError(f"its format has version {version}, expected {VERSION}")
    code = content[_HEADER.size :]
    if zlib.crc32(code) != check or len(code) % 4:
        raise ValueError("it is damaged: its checksum does not agree")
    if not (1 <= depth <= 16 and 0 < height * width <= _MOST_PIXELS and count <= height * width):
        raise ValueError(f"it claims {height}x{width} px, {count} points and {depth} bits a label")
    if not -np.inf < low <= high < np.inf:
        raise ValueError(f"its range is {low} to {high}, expected finite numbers in order")
    bits = _Bits(np.frombuffer(code, "<u4").astype(np.uint32))
    cut = _bitmap(bits, np.zeros((height, width), np.int64), None)
    point = _bitmap(bits, _around(cut, first(height, width, count)), None)
    if int(point.sum()) != count:
        raise ValueError(f"it claims {count} points, and has {int(point.sum())}")
    label = _labels(bits, point, cut, depth, None)
    return Parts(cut, point, label, depth, (low, high))


def _around(cut: np.ndarray, first: np.ndarray) -> np.ndarray:
    """What is known about a place before its point is: cuts nearby, and whether it is likely."""
    padded = np.pad(cut.astype(np.int64), 1)
    height, width = cut.shape
    near = sum(padded[y : y + height, x : x + width] for y in range(3) for x in range(3))
    return 8 * np.minimum(near, 3) + 2 * cut + first


def _bitmap(bits: _Bits, known: np.ndarray, plane: np.ndarray | None) -> np.ndarray:
    """Codes a plane of bits, each in the context of ten before it and of what is known there."""
    height, width = known.shape
    above = [[0] * (width + 4) for _ in range(2)]
    rows = []
    for y in range(height):
        told = None if plane is None else plane[y].astype(int).tolist()
        row, line = [0] * (width + 4), known[y].tolist()
        farther, nearer = above
        left = 0
        upper = nearer[2] << 1 | nearer[3]
        top = farther[2]
        for x in range(width):
            upper = (upper << 1 | nearer[x + 4]) & 31
            top = (top << 1 | farther[x + 3]) & 7
            context = line[x] << 10 | left << 8 | upper << 3 | top
            bit = bits(context, None if told is None else told[x])
            row[x + 2] = bit
            left = (left << 1 | bit) & 3
        above = [nearer, row]
        rows.append(row[2:-2])
    return np.asarray(rows, bool)


def _labels(
    bits: _Bits, point: np.ndarray, cut: np.ndarray, depth: int, label: np.ndarray | None
) -> np.ndarray:
    """Codes labels by their differences from that of the nearest point before."""
    reach = 24
    height, width = point.shape
    # Of every column's last point: row and label; none is far away.
    row, last = np.full(width, -(10**6)), np.zeros(width, np.int64)
    columns, given = np.arange(width), None if label is None else iter(label.tolist())
    found = []
    for y, x in zip(*np.nonzero(point), strict=True):
        window = slice(max(x - reach, 0), x + reach + 1)
        away = (columns[window] - x) ** 2 + (row[window] - y) ** 2
        k = int(away.argmin())
        near, guess = int(away[k]), int(last[window][k])
        kind = 2 * min(near.bit_length(), 8) + int(cut[y, x])
        difference = None if given is None else next(given) - guess
        value = guess + _number(bits, kind, difference)
        row[x], last[x] = y, value
        found.append(value)
    values = np.asarray(found, np.int64)
    if len(values) and not 0 <= values.min() <= values.max() < 1 << depth:
        raise ValueError(f"it has labels from {values.min()} to {values.max()} of {depth} bits")
    return values


def _number(bits: _Bits, kind: int, value: int | None) -> int:
    """Codes a whole number: how many bits it has, its sign, and the bits but the first."""
    size = None if value is None else abs(value).bit_length()
    length = 0
    while length < 17 and bits(
        ("size", kind, length), None if size is None else int(size > length)
    ):
        length += 1
    if length == 0:
        return 0
    negative = bits("sign", None if value is None else int(value < 0))
    number = 1
    for place in range(length - 2, -1, -1):
        # The first two after the leading one are worth learning; the others are noise.
        told = None if value is None else abs(value) >> place & 1
        fresh = length - 2 - place
        number = number << 1 | bits(("digit", length, fresh, number if fresh < 2 else 0), told)
    return -number if negative else number
