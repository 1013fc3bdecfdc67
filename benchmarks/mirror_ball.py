"""A mirror ball for `<model-viewer>`, and what it has to show where cameras and maps are as we think.

World is z up; the file is y up, as in `browser_pictures`. An object that is drawn without its shadows may
look more like its truth under a light from elsewhere; a mirror shows where everything is.
"""

import json
import struct

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_relight import Environment
from lambent_relight.cameras import Camera
from lambent_relight.tone_mapping import tone_mapped
from numpy.typing import NDArray

_RIM = 0.9
"""Share of the ball's radius, as seen, inside of which pictures are compared."""


def ball_glb(rows: int = 96) -> bytes:
    """Return a file of a polished white metal ball of radius 1, at the origin."""
    polar, azimuth = np.meshgrid(
        np.linspace(0.0, np.pi, rows + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rows + 1), indexing="ij"
    )
    place = [np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)]
    points = np.stack(place, axis=-1).reshape(-1, 3).astype("<f4")
    row, column = (index.ravel() for index in np.mgrid[:rows, : 2 * rows])
    first = row * (2 * rows + 1) + column
    below = first + 2 * rows + 1
    faces = np.stack([first, first + 1, below, first + 1, below + 1, below], axis=-1).astype("<u4")
    data = points.tobytes() + faces.tobytes()
    size = len(points.tobytes())
    vector = {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"}
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "material": 0}]}
        ],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 1, "roughnessFactor": 0}}],
        "accessors": [
            {**vector, "min": [-1, -1, -1], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5125, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": size},
            {"buffer": 0, "byteOffset": size, "byteLength": len(data) - size},
        ],
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(data), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(data), 0x004E4942) + data


def reflected(camera: Camera, light: Environment) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return what the ball shows, sRGB-encoded [height, width, 3], and where to look.

    It is shown through the tone curve *neutral*.
    """
    origins, directions = (np.asarray(part, np.float64) for part in camera.rays())
    along = -(origins * directions).sum(axis=-1)
    apart = np.linalg.norm(origins + along[:, None] * directions, axis=-1)
    hit = apart < _RIM
    distance = along - np.sqrt(np.maximum(1.0 - apart**2, 0.0))
    normals = origins + distance[:, None] * directions
    mirrored = directions - 2.0 * (directions * normals).sum(axis=-1, keepdims=True) * normals
    radiance = np.zeros_like(directions)
    radiance[hit] = light.lookup(mirrored[hit])
    shape = (camera.height, camera.width)
    shown = srgb_from_linear(tone_mapped(radiance, "neutral").astype(np.float64))
    return shown.reshape(*shape, 3), hit.reshape(shape)
