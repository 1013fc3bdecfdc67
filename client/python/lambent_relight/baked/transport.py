"""Light transport on the object, baked into texels: independent of the light, and linear in it.

A texel's irradiance under a light with spherical-harmonic coefficients l [coefficient, channel] is
`direct @ l` (directly from the environment, shadows included) plus, per channel, `indirect @ l`
(from other parts of the object). Values are stored as one signed byte each, a plane of texels per
coefficient, with a scale and an offset per plane. Source: docs/reference/bundle-format.md (transport).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from lambent_core.errors import BundleError
from lambent_proto.v1 import bundle_pb2
from numpy.typing import NDArray

from lambent_relight.bundle.bundle import Bundle

Planes = NDArray[np.float32]

NUM_SHADOW_DIRECTIONS = 256
MAX_ATLAS_SIZE = 8192
_MAX_BYTES = 512 << 20
_TEXELS = "transport/texels.bin"
_SHADOW_BITS = "transport/shadow_bits.bin"
# Name of a set of planes: path, channels, smallest and largest number of bands.
_SETS = {
    "direct": ("transport/direct_sh7.bin", 1, 1, 9),
    "visibility": ("transport/visibility_sh4.bin", 1, 1, 9),
    "indirect": ("transport/indirect_sh3.bin", 3, 1, 9),
    "material": ("transport/material.bin", 8, 1, 1),
}


@dataclass(frozen=True, eq=False)
class Transport:
    """Baked light transport; texels are those the surface covers, row by row from the top of the atlas."""

    size: int
    """Texels along a side of the square atlas."""
    texel_index: NDArray[np.int32]
    """Place of every covered texel, row * size + column, rising [texel]."""
    direct: Planes
    """Transfer from the environment to irradiance, [bands^2, texel]."""
    visibility: Planes
    """Visibility of the sky, mirrored below the surface's horizon, as harmonics [bands^2, texel]."""
    indirect: Planes
    """Transfer to irradiance by way of other surfaces, [bands^2, channel, coarse texel]."""
    shadow_bits: NDArray[np.uint8] | None
    """Bit j of a row: direction j of `shadow_directions` is free; lowest first, [texel, directions / 8]."""
    material: Planes
    """Albedo (3), perceptual roughness, metalness, world normal (3), [8, texel]."""

    @property
    def num_texels(self) -> int:
        """The number of covered texels."""
        return len(self.texel_index)

    @cached_property
    def coarse_of_texel(self) -> NDArray[np.int32]:
        """The coarse texel (a block of 2 x 2) that every texel lies in, [texel]."""
        return coarse_blocks(self.size, self.texel_index)[1]


def shadow_directions() -> NDArray[np.float64]:
    """Return 256 even unit directions [j, 3]: z = 1 - (2j + 1) / 256, azimuth j pi (3 - sqrt 5)."""
    j = np.arange(NUM_SHADOW_DIRECTIONS)
    z = 1.0 - (2.0 * j + 1.0) / NUM_SHADOW_DIRECTIONS
    azimuth = j * (np.pi * (3.0 - np.sqrt(5.0)))
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)


def coarse_blocks(size: int, texel_index: NDArray[np.int32]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the first texel of every covered 2 x 2 block, and the block that each texel lies in.

    Blocks are numbered in the order of their place in the atlas of half the side (rounded up).
    """
    row, column = np.divmod(texel_index.astype(np.int64), size)
    block = (row // 2) * (-(-size // 2)) + column // 2
    _, first, parent = np.unique(block, return_index=True, return_inverse=True)
    return first, parent.astype(np.int32)


def quantised(values: NDArray[np.floating]) -> tuple[NDArray[np.int8], list[float], list[float]]:
    """Return planes [plane, texel] as signed bytes q with scales s and offsets o: value = o + s q."""
    low, high = values.min(axis=1).astype(np.float64), values.max(axis=1).astype(np.float64)
    offset, scale = 0.5 * (low + high), np.maximum(high - low, 1e-12) / 254.0
    steps = np.round((values - offset[:, None]) / scale[:, None])
    return np.clip(steps, -127, 127).astype(np.int8), scale.tolist(), offset.tolist()


def dequantised(data: bytes, scales: list[float], offsets: list[float]) -> Planes:
    """Return the values of `quantised` planes, [plane, texel]."""
    steps = np.frombuffer(data, np.int8).reshape(len(scales), -1)
    scale, offset = np.array(scales, np.float32), np.array(offsets, np.float32)
    return offset[:, None] + scale[:, None] * steps.astype(np.float32)


def transport_files(transport: Transport, manifest: bundle_pb2.BundleManifest) -> dict[str, bytes]:
    """Return the files that hold `transport`, by path, and describe them in `manifest`."""
    stated = manifest.transport
    stated.size, stated.num_texels = transport.size, transport.num_texels
    stated.texels_path = _TEXELS
    covered = np.zeros(transport.size * transport.size, bool)
    covered[transport.texel_index] = True
    files = {_TEXELS: np.packbits(covered, bitorder="little").tobytes()}
    for name, (path, channels, _, _) in _SETS.items():
        planes = getattr(transport, name)
        bands = 1 if name == "material" else round(len(planes) ** 0.5)
        steps, scales, offsets = quantised(planes.reshape(-1, planes.shape[-1]))
        files[path] = steps.tobytes()
        stated.planes.add(
            name=name, path=path, bands=bands, channels=channels, scales=scales, offsets=offsets
        )
    if transport.shadow_bits is not None:
        stated.shadow_bits_path = _SHADOW_BITS
        stated.num_shadow_directions = 8 * transport.shadow_bits.shape[1]
        files[_SHADOW_BITS] = transport.shadow_bits.tobytes()
    return files


def read_transport(bundle: Bundle) -> Transport | None:
    """Return the baked transport of a bundle, or None where it has none.

    Raises BundleError `bundle.transport_invalid` when files and manifest disagree.
    """
    if not bundle.manifest.HasField("transport"):
        return None
    stated = bundle.manifest.transport
    read = partial(bundle.read, limit_bytes=_MAX_BYTES)
    size = stated.size
    if not 1 <= size <= MAX_ATLAS_SIZE:
        raise _invalid(f"has an atlas of {size} texels along a side")
    mask = np.frombuffer(read(stated.texels_path), np.uint8)
    if len(mask) != -(-size * size // 8):
        raise _invalid(f'"{stated.texels_path}" has {len(mask)} bytes for {size} x {size} texels')
    texel_index = np.flatnonzero(np.unpackbits(mask, bitorder="little")[: size * size]).astype(np.int32)
    num_texels = len(texel_index)
    if num_texels != stated.num_texels or num_texels == 0:
        raise _invalid(f"covers {num_texels} texels, the manifest states {stated.num_texels}")
    num_coarse = len(coarse_blocks(size, texel_index)[0])
    sets = _planes_by_name(stated)
    expected = {name: num_coarse if name == "indirect" else num_texels for name in _SETS}
    planes = {
        name: _read_planes(sets[name], read(sets[name].path), count) for name, count in expected.items()
    }
    bits = None
    if stated.shadow_bits_path:
        if stated.num_shadow_directions != NUM_SHADOW_DIRECTIONS:
            raise _invalid(f"has {stated.num_shadow_directions} shadow directions")
        data = np.frombuffer(read(stated.shadow_bits_path), np.uint8)
        if data.size != num_texels * NUM_SHADOW_DIRECTIONS // 8:
            raise _invalid(f'"{stated.shadow_bits_path}" has {data.size} bytes')
        bits = data.reshape(num_texels, -1)
    bands = sets["indirect"].bands
    indirect = planes["indirect"].reshape(bands**2, 3, num_coarse)
    return Transport(
        size, texel_index, planes["direct"], planes["visibility"], indirect, bits, planes["material"]
    )


def _planes_by_name(stated: bundle_pb2.Transport) -> Mapping[str, bundle_pb2.TransportPlanes]:
    sets = {planes.name: planes for planes in stated.planes}
    for name, (_, channels, least, most) in _SETS.items():
        if name not in sets:
            raise _invalid(f"has no planes {name!r}")
        if sets[name].channels != channels or not least <= sets[name].bands <= most:
            raise _invalid(f"has {name!r} in {sets[name].bands} bands and {sets[name].channels} channels")
    if sets["indirect"].bands > sets["direct"].bands:
        raise _invalid("has more bands of indirect than of direct transfer")
    return sets


def _read_planes(stated: bundle_pb2.TransportPlanes, data: bytes, num_texels: int) -> Planes:
    count = stated.bands**2 * stated.channels
    if len(stated.scales) != count or len(stated.offsets) != count or len(data) != count * num_texels:
        raise _invalid(
            f'"{stated.path[:200]}" has {len(data)} bytes and {len(stated.scales)} scales '
            f"for {count} planes of {num_texels} texels"
        )
    if not np.isfinite([*stated.scales, *stated.offsets]).all():
        raise _invalid(f'"{stated.path[:200]}" has a scale that is not finite')
    return dequantised(data, list(stated.scales), list(stated.offsets))


def _invalid(what: str) -> BundleError:
    return BundleError("bundle.transport_invalid", f"the transport {what}", "export the bundle again")
