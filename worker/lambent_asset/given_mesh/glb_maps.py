"""The maps of a glTF material, looked up at places of a mesh.

Source: glTF 2.0 specification, section 3.9 (metallic-roughness, normal maps); textures are repeated outside
[0, 1] and interpolated bilinearly.
"""

import io
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from lambent_core.colour import linear_from_srgb
from lambent_relight.asset.glb import WEBP
from lambent_relight.baked.mesh import glb_view
from lambent_relight.baked.raster import block_means
from numpy.typing import NDArray
from PIL import Image

_MAX_SIDE = 16384
_FORMATS = ("PNG", "JPEG", "WEBP")
_LEVELS = np.arange(256, dtype=np.float32) / np.float32(255.0)
_LINEAR = linear_from_srgb(_LEVELS).astype(np.float32)
_SIGNED = 2.0 * _LEVELS - 1.0
"""What the 256 levels of a stored picture stand for: gloss, albedo, normals."""
_PLACES_AT_ONCE = 1 << 18
LEAST_ROUGHNESS = 0.03
"""Perceptual roughness is at least this: the lobe of a perfect mirror has no width to bake with."""
Picture = NDArray[np.uint8] | NDArray[np.float32]
"""[height, width, 3]: levels as stored in the file, or values as they are meant where it was reduced."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Maps:
    """A material: factors, and pictures that they multiply; None where there is no picture."""

    albedo_factor: NDArray[np.float32]
    """[3], linear."""
    perceptual_roughness_factor: float
    metalness_factor: float
    normal_scale: float = 1.0
    """Multiplies x and y of the normal map."""
    albedo: Picture | None = None
    """Levels are sRGB-encoded, values linear Rec. 709."""
    packed: Picture | None = None
    """Anything, perceptual roughness, metalness."""
    normal: Picture | None = None
    """Tangent space, -1..1, +y towards the top of the picture."""

    @property
    def num_pixels(self) -> int:
        """Return the pixels of all pictures together."""
        return sum(p.shape[0] * p.shape[1] for p in (self.albedo, self.packed, self.normal) if p is not None)

    def reduced(self, size: int) -> "Maps":
        """Return the material with pictures of less than twice `size` texels a side: means over blocks."""
        return replace(
            self,
            albedo=_reduced(self.albedo, size, _LINEAR),
            packed=_reduced(self.packed, size, _LEVELS),
            normal=_reduced(self.normal, size, _SIGNED),
        )

    def albedo_at(self, uv: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the albedo [place, 3] at texture coordinates [place, 2], linear, 0..1."""
        if self.albedo is None:
            colour = np.ones((len(uv), 3), np.float32)
        else:
            colour = sampled(self.albedo, uv, _LINEAR)
        return np.clip(colour * self.albedo_factor, 0.0, 1.0).astype(np.float32)

    def gloss_at(self, uv: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return perceptual roughness and metalness, [place, 1] each."""
        if self.packed is None:
            packed = np.ones((len(uv), 3), np.float32)
        else:
            packed = sampled(self.packed, uv, _LEVELS)
        roughness = np.clip(packed[:, 1:2] * self.perceptual_roughness_factor, LEAST_ROUGHNESS, 1.0)
        return roughness.astype(np.float32), np.clip(packed[:, 2:3] * self.metalness_factor, 0.0, 1.0)

    def normal_at(self, uv: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Return tangent-space normals [place, 3], not unit, or None without a normal map."""
        if self.normal is None:
            return None
        scale = np.array([self.normal_scale, self.normal_scale, 1.0], np.float32)
        return sampled(self.normal, uv, _SIGNED) * scale


def sampled(
    picture: Picture, uv: NDArray[np.floating], table: NDArray[np.float32] = _LEVELS
) -> NDArray[np.float32]:
    """Return a picture [height, width, n] at texture coordinates [place, 2], bilinear, repeated.

    Levels of 8 bits are what `table` [256] says before they are interpolated.
    """
    values = np.empty((len(uv), picture.shape[2]), np.float32)
    for start in range(0, len(uv), _PLACES_AT_ONCE):
        part = slice(start, start + _PLACES_AT_ONCE)
        values[part] = _bilinear(picture, uv[part], table)
    return values


def _bilinear(picture: Picture, uv: NDArray[np.floating], table: NDArray[np.float32]) -> NDArray[np.floating]:
    height, width = picture.shape[:2]
    x, y = uv[:, 0].astype(np.float64) * width - 0.5, uv[:, 1].astype(np.float64) * height - 0.5
    left, top = np.floor(x), np.floor(y)
    fx, fy = (x - left)[:, None].astype(np.float32), (y - top)[:, None].astype(np.float32)
    columns = [(left.astype(np.int64) + step) % width for step in (0, 1)]
    rows = [(top.astype(np.int64) + step) % height for step in (0, 1)]
    upper, lower = (
        _values(picture[row, columns[0]], table) * (1.0 - fx) + _values(picture[row, columns[1]], table) * fx
        for row in rows
    )
    return upper * (1.0 - fy) + lower * fy


def _values(stored: Picture, table: NDArray[np.float32]) -> NDArray[np.float32]:
    return table[stored] if stored.dtype == np.uint8 else np.asarray(stored, np.float32)


def _reduced(picture: Picture | None, size: int, table: NDArray[np.float32]) -> Picture | None:
    factor = 1 if picture is None else min(picture.shape[:2]) // size
    if picture is None or factor < 2:
        return picture
    # Row by row of blocks: the values of a whole picture take four times the room of its levels.
    rows = range(0, picture.shape[0] // factor * factor, factor)
    return np.concatenate(
        [block_means(_values(picture[row : row + factor], table), factor).astype(np.float32) for row in rows]
    )


def maps_of(document: dict[str, Any], payload: bytes, number: int, *, has_uv: bool) -> Maps | None:
    """Return the material `number` of a document, or None where its pictures have no texture coordinates.

    Raises KeyError, IndexError, TypeError or ValueError for a material that cannot be read.
    """
    material = document["materials"][number]
    surface = material.get("pbrMetallicRoughness", {})
    slots = {
        "albedo": surface.get("baseColorTexture"),
        "packed": surface.get("metallicRoughnessTexture"),
        "normal": material.get("normalTexture"),
    }
    if not has_uv and any(slot is not None for slot in slots.values()):
        return None
    pictures = {name: _picture(document, payload, slot) for name, slot in slots.items() if slot is not None}
    colour = np.array(surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0)), np.float32)
    factors = (surface.get("roughnessFactor", 1.0), surface.get("metallicFactor", 1.0))
    if colour.shape != (4,) or not np.isfinite([*colour, *factors]).all():
        raise ValueError("a material has factors that are not numbers")
    scale = float(material["normalTexture"].get("scale", 1.0)) if "normal" in pictures else 1.0
    if not np.isfinite(scale):
        raise ValueError("a normal map has a scale that is not a number")
    return Maps(
        albedo_factor=colour[:3],
        perceptual_roughness_factor=float(factors[0]),
        metalness_factor=float(factors[1]),
        normal_scale=scale,
        **pictures,
    )


def _picture(document: dict[str, Any], payload: bytes, slot: dict[str, Any]) -> NDArray[np.uint8]:
    """Return the pixels [height, width, 3] of a texture as stored."""
    if slot.get("texCoord", 0) != 0:
        raise ValueError("a texture uses a second set of texture coordinates")
    if "KHR_texture_transform" in slot.get("extensions", {}):
        raise ValueError("a texture is moved or scaled by a mapping; bake it into the texture coordinates")
    texture = document["textures"][slot["index"]]
    source = texture.get("extensions", {}).get(WEBP, texture)["source"]
    image = document["images"][source]
    if "bufferView" not in image:
        raise ValueError("a texture lies outside the file")
    data = glb_view(document, payload, image["bufferView"])
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as opened:
            if max(opened.size) > _MAX_SIDE:
                raise ValueError(f"a texture of {opened.size[0]} x {opened.size[1]} pixels")
            return np.asarray(opened.convert("RGB"))
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"a texture is not a whole {', '.join(_FORMATS)} file") from error
