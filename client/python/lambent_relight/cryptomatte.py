"""The object's mask as Cryptomatte, which compositing programs pick by name.

One object and one layer: rank 0 is the object with its coverage, rank 1 is empty. Channels must stay 32-bit
floats and must not be filtered, for an id is the bits of a float. Source: Cryptomatte specification 1.2.0
(Psyop), sections on hashing, encoding and metadata; MurmurHash3_x86_32 (Appleby) with seed 0.
"""

import json
import struct

import numpy as np
from numpy.typing import NDArray

LAYER = "CryptoObject"
CHANNELS = tuple(f"{LAYER}00.{letter}" for letter in "RGBA")
"""Id and coverage of rank 0, id and coverage of rank 1."""
_MASK = 0xFFFFFFFF


def murmur3(data: bytes) -> int:
    """Return MurmurHash3_x86_32 of `data` with seed 0, an unsigned 32-bit number."""
    state = 0
    whole = len(data) // 4 * 4
    for (block,) in struct.iter_unpack("<I", data[:whole]):
        state = _rotated(state ^ _scrambled(block), 13) * 5 + 0xE6546B64 & _MASK
    if len(data) > whole:
        state ^= _scrambled(int.from_bytes(data[whole:], "little"))
    state ^= len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        state = (state ^ state >> shift) * factor & _MASK
    return state ^ state >> 16


def _rotated(value: int, bits: int) -> int:
    return (value << bits | value >> 32 - bits) & _MASK


def _scrambled(block: int) -> int:
    return _rotated(block * 0xCC9E2D51 & _MASK, 15) * 0x1B873593 & _MASK


def id_bits(name: str) -> int:
    """Return the bits of the float that stands for `name`: its hash, never denormal, infinite or NaN."""
    hashed = murmur3(name.encode("utf-8"))
    exponent = min(max(hashed >> 23 & 0xFF, 1), 254)
    return hashed & 0x807FFFFF | exponent << 23


def cryptomatte_channels(name: str, coverage: NDArray[np.floating]) -> dict[str, NDArray[np.float32]]:
    """Return the channels of one object called `name` with `coverage` [height, width] in [0, 1]."""
    share = np.asarray(coverage, np.float32)
    ids = np.full(share.shape, id_bits(name), np.uint32).view(np.float32)
    nothing = np.zeros_like(share)
    planes = (np.where(share > 0.0, ids, nothing), np.maximum(share, nothing), nothing, nothing)
    return dict(zip(CHANNELS, planes, strict=True))


def cryptomatte_attributes(name: str) -> dict[str, str]:
    """Return the attributes of an EXR with the channels of one object called `name`."""
    key = f"cryptomatte/{murmur3(LAYER.encode()):08x}"[: len("cryptomatte/") + 7]
    return {
        f"{key}/name": LAYER,
        f"{key}/hash": "MurmurHash3_32",
        f"{key}/conversion": "uint32_to_float32",
        f"{key}/manifest": json.dumps(
            {name: f"{id_bits(name):08x}"}, ensure_ascii=False, separators=(",", ":")
        ),
    }
