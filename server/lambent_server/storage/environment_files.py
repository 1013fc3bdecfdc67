"""Headers of OpenEXR and Radiance files: format and size, without decoding a pixel.

Read in a process of its own (`decoding`).
"""

import re
import struct
from dataclasses import dataclass

from lambent_server.api.problems import Problem, invalid

HEAD_BYTES = 64 * 1024
MEDIA_TYPES = {"exr": "image/x-exr", "hdr": "image/vnd.radiance"}
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_HDR_SIZE = re.compile(rb"\n([-+][XY]) (\d{1,9}) ([-+][XY]) (\d{1,9})\n")


@dataclass(frozen=True, slots=True)
class EnvironmentHead:
    """The contents of a file's header."""

    format: str
    width: int
    height: int


def _broken(message: str) -> Problem:
    return invalid("environment_invalid", "#", message)


def parse_head(head: bytes, max_pixels: int) -> EnvironmentHead:
    """Return format and size from the first `HEAD_BYTES` of a file.

    Raises `environment_invalid` if it is not a usable environment.
    """
    if head.startswith(_EXR_MAGIC):
        result = _read_exr(head, max_pixels)
    elif head.startswith((b"#?RADIANCE", b"#?RGBE")):
        result = _read_hdr(head)
    else:
        raise _broken("this is neither an OpenEXR nor a Radiance HDR file")
    if result.width < 1 or result.height < 1 or result.width * result.height > max_pixels:
        raise _broken(f"{result.width} x {result.height} pixels are not between 1 and {max_pixels} in all")
    return result


def _read_exr(head: bytes, max_pixels: int) -> EnvironmentHead:
    """Return the size of the first part with colour.

    All parts are checked, because a reader decodes them all: none may be deep, and together they hold at most
    four channels of `max_pixels`.
    """
    version = int.from_bytes(head[4:8], "little")
    # Bits of the version field: 0x200 tiled, 0x400 long names, 0x800 deep, 0x1000 several parts.
    if version & 0xFF != 2 or version & 0x800:
        raise _broken("only flat OpenEXR 2 pictures are read, no deep pictures")
    at, several, values, coloured = 8, bool(version & 0x1000), 0, []
    while True:
        attributes, at = _attributes(head, at)
        window = attributes.get(b"dataWindow:box2i", b"")
        names = _channel_names(attributes.get(b"channels:chlist", b""))
        if len(window) != 16 or not names:
            raise _broken("the OpenEXR file has no data window or no channels")
        left, top, right, bottom = struct.unpack("<4i", window)
        width, height = right - left + 1, bottom - top + 1
        values += max(width, 0) * max(height, 0) * len(names)
        if {b"R", b"G", b"B"} <= set(names):
            coloured.append(EnvironmentHead("exr", width, height))
        # The last of several headers is followed by an empty one.
        if not several or head[at : at + 1] in (b"\0", b""):
            break
    if not coloured:
        raise _broken("the OpenEXR picture needs the channels R, G and B in one part")
    if values > 4 * max_pixels:
        raise _broken(
            f"all channels hold {values} values, more than {4 * max_pixels}; save the map as RGB alone"
        )
    return coloured[0]


def _attributes(head: bytes, at: int) -> tuple[dict[bytes, bytes], int]:
    """Return the attributes of the header at an offset, by name and type, and the offset of its end."""
    attributes: dict[bytes, bytes] = {}
    while head[at : at + 1] not in (b"\0", b""):
        name, type_, rest = _strings(head, at)
        (size,) = struct.unpack_from("<i", head, rest) if len(head) >= rest + 4 else (-1,)
        if size < 0 or rest + 4 + size > len(head):
            raise _broken("the header of the OpenEXR file is truncated or too long")
        attributes[name + b":" + type_] = head[rest + 4 : rest + 4 + size]
        at = rest + 4 + size
    return attributes, at + 1


def _strings(head: bytes, at: int) -> tuple[bytes, bytes, int]:
    middle = head.find(b"\0", at, at + 256)
    end = head.find(b"\0", middle + 1, middle + 257)
    if middle < 0 or end < 0:
        raise _broken("the header of the OpenEXR file cannot be read")
    return head[at:middle], head[middle + 1 : end], end + 1


def _channel_names(channels: bytes) -> list[bytes]:
    """Return the names in a channel list: each is ended by a zero and followed by 16 bytes."""
    names, at = [], 0
    while at < len(channels) and channels[at] != 0:
        end = channels.find(b"\0", at)
        if end < 0:
            break
        names.append(channels[at:end])
        at = end + 17
    return names


def _read_hdr(head: bytes) -> EnvironmentHead:
    end = head.find(b"\n\n")
    match = _HDR_SIZE.match(head, end + 1) if end >= 0 else None
    if match is None:
        raise _broken("the Radiance file does not state its size")
    sizes = {match[1][1:]: int(match[2]), match[3][1:]: int(match[4])}
    if len(sizes) < 2:
        raise _broken("the Radiance file does not state both of its sizes")
    return EnvironmentHead("hdr", sizes[b"X"], sizes[b"Y"])
