"""The maps of a glTF material, looked up at places of a mesh.

Source: glTF 2.0 specification, section 3.9 (metallic-roughness, normal maps); textures are repeated outside
[0, 1] and interpolated bilinearly.
"""

import io
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from lambent_relight.asset.glb import WEBP
from lambent_relight.baked.raster import block_means
from lambent_relight.images import linear_from_srgb
from numpy.typing import NDArray
from PIL import Image

_MAX_SIDE = 16384
_FORMATS = ("PNG", "JPEG", "WEBP")
LEAST_ROUGHNESS = 0.03
"""Perceptual roughness is at least this: the lobe of a perfect mirror has no width to bake with."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Maps:
    """A material: factors, and pictures that they multiply; None where there is no picture."""

    albedo_factor: NDArray[np.float32]
    """[3], linear."""
    perceptual_roughness_factor: float
    metalness_factor: float
    albedo: NDArray[np.float32] | None = None
    """[height, width, 3], linear Rec. 709."""
    packed: NDArray[np.float32] | None = None
    """[height, width, 3]: anything, perceptual roughness, metalness."""
    normal: NDArray[np.float32] | None = None
    """[height, width, 3], tangent space, -1..1, +y towards the top of the picture; already scaled."""

    def reduced(self, size: int) -> "Maps":
        """Return the material with pictures of less than twice `size` texels a side: means over blocks."""
        return replace(
            self,
            **{name: _reduced(getattr(self, name), size) for name in ("albedo", "packed", "normal")},
        )

    def albedo_at(self, uv: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the albedo [place, 3] at texture coordinates [place, 2], linear, 0..1."""
        found = np.ones((len(uv), 3), np.float32) if self.albedo is None else sampled(self.albedo, uv)
        return np.clip(found * self.albedo_factor, 0.0, 1.0).astype(np.float32)

    def gloss_at(self, uv: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return perceptual roughness and metalness, [place, 1] each."""
        found = np.ones((len(uv), 3), np.float32) if self.packed is None else sampled(self.packed, uv)
        roughness = np.clip(found[:, 1:2] * self.perceptual_roughness_factor, LEAST_ROUGHNESS, 1.0)
        return roughness.astype(np.float32), np.clip(found[:, 2:3] * self.metalness_factor, 0.0, 1.0)

    def normal_at(self, uv: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Return tangent-space normals [place, 3], not unit, or None without a normal map."""
        return None if self.normal is None else sampled(self.normal, uv)


def sampled(picture: NDArray[np.float32], uv: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return a picture [height, width, n] at texture coordinates [place, 2], bilinear, repeated."""
    height, width = picture.shape[:2]
    x, y = uv[:, 0].astype(np.float64) * width - 0.5, uv[:, 1].astype(np.float64) * height - 0.5
    left, top = np.floor(x), np.floor(y)
    fx, fy = (x - left)[:, None].astype(np.float32), (y - top)[:, None].astype(np.float32)
    columns = [(left.astype(np.int64) + step) % width for step in (0, 1)]
    rows = [(top.astype(np.int64) + step) % height for step in (0, 1)]
    upper, lower = (picture[row, columns[0]] * (1.0 - fx) + picture[row, columns[1]] * fx for row in rows)
    return (upper * (1.0 - fy) + lower * fy).astype(np.float32)


def _reduced(picture: NDArray[np.float32] | None, size: int) -> NDArray[np.float32] | None:
    factor = 1 if picture is None else min(picture.shape[:2]) // size
    if picture is None or factor < 2:
        return picture
    return block_means(picture, factor).astype(np.float32)


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
        raise ValueError("a material has factors that are no numbers")
    if "albedo" in pictures:
        pictures["albedo"] = linear_from_srgb(pictures["albedo"]).astype(np.float32)
    if "normal" in pictures:
        bent = 2.0 * pictures["normal"] - 1.0
        bent[..., :2] *= np.float32(material["normalTexture"].get("scale", 1.0))
        pictures["normal"] = bent
    return Maps(
        albedo_factor=colour[:3],
        perceptual_roughness_factor=float(factors[0]),
        metalness_factor=float(factors[1]),
        **pictures,
    )


def _picture(document: dict[str, Any], payload: bytes, slot: dict[str, Any]) -> NDArray[np.float32]:
    """Return the pixels [height, width, 3] of a texture, 0..1 as stored."""
    if slot.get("texCoord", 0) != 0:
        raise ValueError("a texture uses a second set of texture coordinates")
    if "KHR_texture_transform" in slot.get("extensions", {}):
        raise ValueError("a texture is moved or scaled by a mapping; bake it into the texture coordinates")
    texture = document["textures"][slot["index"]]
    source = texture.get("extensions", {}).get(WEBP, texture)["source"]
    image = document["images"][source]
    if "bufferView" not in image:
        raise ValueError("a texture lies outside the file")
    view = document["bufferViews"][image["bufferView"]]
    start, size = view.get("byteOffset", 0), view["byteLength"]
    if not all(isinstance(n, int) and n >= 0 for n in (start, size)) or start + size > len(payload):
        raise ValueError("a texture leaves the file")
    try:
        with Image.open(io.BytesIO(payload[start : start + size]), formats=_FORMATS) as opened:
            if max(opened.size) > _MAX_SIDE:
                raise ValueError(f"a texture of {opened.size[0]} x {opened.size[1]} pixels")
            return np.asarray(opened.convert("RGB"), np.float32) / np.float32(255.0)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"a texture is no whole {', '.join(_FORMATS)} file") from error
