"""Lines of Radiance pictures: run-length coded, flat, or flat with the old format's repeats.

As in Radiance, each line is decided for itself: one that begins with (2, 2, its length) is coded. Flat pixels
can begin like that, too. A file is therefore read line by line first; where that is impossible, all of it is
taken as flat, if it then ends where the pixels do.
"""

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
"""Red, green, blue, exponent in the last axis."""


class DamagedLinesError(Exception):
    """The lines cannot be decoded; the text is the end of a sentence about the file."""


def decode_lines(data: memoryview, lines: int, length: int) -> Pixels:
    """Return the pixels [lines, length, 4] of the bytes behind the header; raises DamagedLinesError."""
    try:
        return _line_by_line(data, lines, length)
    except DamagedLinesError as error:
        flat = _all_flat(data, lines * length)
        if flat is None:
            raise error from None
        return flat.reshape(lines, length, 4)


def _line_by_line(data: memoryview, lines: int, length: int) -> Pixels:
    pixels = np.empty((lines, length, 4), np.uint8)
    head = bytes((2, 2, length >> 8, length & 255)) if 8 <= length <= 32767 else None
    position = 0
    for line in range(lines):
        if head is not None and bytes(data[position : position + 4]) == head:
            decoded, position = _coded(data, position + 4, 4 * length, line)
            pixels[line] = np.frombuffer(decoded, np.uint8).reshape(4, length).T
        else:
            pixels[line], position = _flat(data, position, length, line)
    return pixels


def _coded(data: memoryview, position: int, size: int, line: int) -> tuple[bytearray, int]:
    """Return `size` bytes of run-length coded planes, and the position behind them."""
    decoded = bytearray()
    end = len(data)
    while len(decoded) < size:
        if position + 1 >= end:
            raise DamagedLinesError(f"ends early at row {line}")
        count = data[position]
        if count > 128:
            decoded += bytes((data[position + 1],)) * (count - 128)
            position += 2
        else:
            decoded += data[position + 1 : position + 1 + count]
            position += 1 + count
        if count == 0 or position > end:
            raise DamagedLinesError(f"is damaged at row {line}")
    if len(decoded) != size:
        raise DamagedLinesError(f"has a run over the end of row {line}")
    return decoded, position


def _flat(data: memoryview, position: int, length: int, line: int) -> tuple[Pixels, int]:
    """Return a line of flat pixels, whose repeats end with it, and the position behind it."""
    stored = _as_pixels(data[position : position + 4 * length])
    counts, source = _repeats(stored)
    ends = np.cumsum(counts)
    last = int(np.searchsorted(ends, length))
    if last == len(stored):
        raise DamagedLinesError(f"ends early at row {line}")
    if ends[last] != length:
        raise DamagedLinesError(f"has a run over the end of row {line}")
    # Higher digits of the last count, which add nothing where they are 0, belong to the line as well.
    return np.repeat(stored[source[: last + 1]], counts[: last + 1], axis=0), position + 4 * (last + 1)


def _all_flat(data: memoryview, number: int) -> Pixels | None:
    """Return all pixels of a file without lines, or None where it does not end with them."""
    stored = _as_pixels(data)
    try:
        counts, source = _repeats(stored)
    except DamagedLinesError:
        return None
    # The last repeat may run over the end, as old writers let it; nothing may follow.
    if counts.sum() < number or counts[:-1].sum() >= number:
        return None
    index = np.searchsorted(np.cumsum(counts), np.arange(number), side="right")
    return stored[source[index]]


def _as_pixels(data: memoryview) -> Pixels:
    return np.frombuffer(data[: len(data) // 4 * 4], np.uint8).reshape(-1, 4)


def _repeats(stored: Pixels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return how often each stored pixel counts, and which one it shows: (1, 1, 1, n) repeats."""
    marks = (stored[:, :3] == 1).all(axis=1)
    counts, places = np.ones(len(stored), np.int64), np.arange(len(stored))
    if not marks.any():
        return counts, places
    if marks[0]:
        raise DamagedLinesError("repeats a pixel that is not there")
    # Consecutive repeats are digits of one count, least significant first.
    source = np.maximum.accumulate(np.where(marks, 0, places))
    digits = (places - source - 1)[marks]
    if digits.max() > 3:
        raise DamagedLinesError("repeats a pixel that is not there")
    counts[marks] = stored[marks, 3].astype(np.int64) << (8 * digits)
    return counts, source
