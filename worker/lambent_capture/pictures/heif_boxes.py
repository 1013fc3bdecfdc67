"""Colours that a HEIC or AVIF states by code points: the nclx box of its primary picture.

Pillow and libheif give pixels and ICC profiles, and leave these numbers out. Source: ISO/IEC 14496-12
(boxes), 23008-12 (items and their properties).
"""

from collections.abc import Iterator
from pathlib import Path

MOST_BYTES = 4 * 2**20
"""A `meta` box is a few kilobytes; a larger one is not looked into."""


def nclx_of(path: Path) -> tuple[int, int] | None:
    """Return primaries and transfer (ITU-T H.273) of the primary picture, or None where none are stated.

    A damaged file states nothing here: decoding it says what is wrong.
    """
    meta = _meta(path)
    boxes = dict(_boxes(meta[4:])) if meta else {}
    properties = dict(_boxes(boxes.get(b"iprp", b"")))
    described = list(_boxes(properties.get(b"ipco", b"")))
    primary = _primary(boxes.get(b"pitm", b""))
    numbers = _associated(properties.get(b"ipma", b""), primary)
    chosen = [described[number - 1] for number in numbers if 0 < number <= len(described)]
    for kind, data in chosen or described:
        if kind == b"colr" and data[:4] == b"nclx" and len(data) >= 8:
            return int.from_bytes(data[4:6], "big"), int.from_bytes(data[6:8], "big")
    return None


def _meta(path: Path) -> bytes:
    with path.open("rb") as file:
        for _ in range(64):
            start = file.read(8)
            if len(start) < 8:
                break
            size, kind, used = int.from_bytes(start[:4], "big"), start[4:], 8
            if size == 1:
                size, used = int.from_bytes(file.read(8), "big"), 16
            if kind == b"meta":
                return file.read(min(size - used, MOST_BYTES)) if size > used else file.read(MOST_BYTES)
            if size < used:
                break
            file.seek(size - used, 1)
    return b""


def _boxes(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at + 8 <= len(data):
        size, used = int.from_bytes(data[at : at + 4], "big"), 8
        if size == 1:
            size, used = int.from_bytes(data[at + 8 : at + 16], "big"), 16
        size = size or len(data) - at
        if size < used:
            return
        yield data[at + 4 : at + 8], data[at + used : at + size]
        at += size


def _primary(data: bytes) -> int:
    width = 2 if data[:1] == b"\0" else 4
    return int.from_bytes(data[4 : 4 + width], "big")


def _associated(data: bytes, item: int) -> list[int]:
    """Return the numbers, from 1, of the properties of an item."""
    id_bytes = 2 if data[:1] == b"\0" else 4
    index_bytes = 2 if data[3:4] and data[3] & 1 else 1
    mask = 0x7FFF if index_bytes == 2 else 0x7F
    at, numbers = 8, []
    for _ in range(min(int.from_bytes(data[4:8], "big"), 100_000)):
        if at + id_bytes + 1 > len(data):
            break
        current, count = int.from_bytes(data[at : at + id_bytes], "big"), data[at + id_bytes]
        at += id_bytes + 1
        for _ in range(count):
            if current == item:
                numbers.append(int.from_bytes(data[at : at + index_bytes], "big") & mask)
            at += index_bytes
    return numbers
