"""Pictures by which people recognise a bundle: its object in the light of a studio, before a plain backdrop.

`poster.webp` stands for the object on pages and in link previews until the viewer has loaded;
`thumbnail.webp` is the same picture for lists. Light, exposure and backdrop are ours, not the capture's.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from lambent_core.colour import srgb_from_linear
from lambent_core.directions import pixel_directions
from lambent_proto.v1 import bundle_pb2
from lambent_relight.baked.mesh import read_mesh
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.cameras import Camera, look_at, position_around
from lambent_relight.environment.maps import Environment, environment_from_array
from lambent_relight.picture import RelitPicture
from lambent_relight.renderer import Renderer
from lambent_relight.tone_mapping import tone_mapped
from numpy import ndarray
from PIL import Image

from lambent_asset.transport.transport_quality import opened

POSTER_PATH = "poster.webp"
THUMBNAIL_PATH = "thumbnail.webp"
POSTER_SIZE = (1024, 768)
THUMBNAIL_SIZE = (512, 384)
FIELD_OF_VIEW_DEG = 30.0
"""Horizontal: that of a lens for portraits, which bends shapes little."""
ELEVATION_DEG = 20.0
"""The photograph whose elevation is nearest to this is the view: so one looks at a table."""
FILLED = 0.78
"""Share of the picture's width or height that the object takes."""
BRIGHT, BRIGHT_LEVEL = 95.0, 0.7
"""This percentile of the object's luminance is brought to this level, within `GAINS`."""
GAINS = (0.6, 2.5)
_QUALITY = 86
_ROUNDS = 20
_BACKDROP_MIDDLE = np.array([0.93, 0.925, 0.915])
_BACKDROP_EDGE = np.array([0.78, 0.775, 0.765])


def write_poster(folder: Path, manifest: bundle_pb2.BundleManifest) -> None:
    """Write `poster.webp` and `thumbnail.webp` into `folder`, whose manifest may still lack its files.

    Does nothing for a bundle without baked transport: only that is quick enough for a picture aside.
    """
    if not manifest.HasField("transport"):
        return
    # What a browser without the networks shows; reading these would take longer than the picture.
    pixels = poster(opened(folder, manifest, networks=False))
    image = Image.fromarray(pixels)
    image.save(folder / POSTER_PATH, "WEBP", quality=_QUALITY, method=6)
    small = image.resize(THUMBNAIL_SIZE, Image.Resampling.LANCZOS)
    small.save(folder / THUMBNAIL_PATH, "WEBP", quality=_QUALITY, method=6)


def try_poster(folder: Path, manifest: bundle_pb2.BundleManifest) -> str:
    """Write the pictures as `write_poster` does; returns why it could not, or "": a bundle does without."""
    try:
        write_poster(folder, manifest)
    except Exception as error:  # Everything else of the bundle is there.
        for path in (POSTER_PATH, THUMBNAIL_PATH):
            (folder / path).unlink(missing_ok=True)
        return repr(error)[:200]
    return ""


def poster(bundle: Bundle) -> UInt8[ndarray, "height width 3"]:
    """Return the sRGB pixels of the poster; raises UnsupportedQuality without baked transport."""
    azimuth_deg, elevation_deg = side_of(bundle)
    camera = framed(read_mesh(bundle).vertices, azimuth_deg, elevation_deg)
    picture = Renderer(bundle).render(camera, studio(azimuth_deg), quality="baked", antialias=2)
    shown = srgb_from_linear(tone_mapped(picture.rgb * _gain(picture), "neutral"))
    cover = picture.opacity
    behind = _backdrop(camera.height, camera.width)
    return np.round(255.0 * (shown * cover + behind * (1.0 - cover))).astype(np.uint8)


def side_of(bundle: Bundle) -> tuple[float, float]:
    """Return azimuth and elevation of the view, degrees: those from which the web viewer opens the bundle."""
    target = (np.array(bundle.manifest.bounds.minimum) + np.array(bundle.manifest.bounds.maximum)) / 2.0
    offsets = np.array([camera.camera_to_world[:3, 3] for camera in bundle.cameras()]) - target
    elevations = np.degrees(np.arctan2(offsets[:, 2], np.hypot(offsets[:, 0], offsets[:, 1])))
    nearest = int(np.argmin(np.abs(elevations - ELEVATION_DEG)))
    azimuth = np.degrees(np.arctan2(offsets[nearest, 1], offsets[nearest, 0]))
    return float(azimuth), float(elevations[nearest])


def framed(
    vertices: Float[ndarray, "vertices 3"],
    azimuth_deg: float,
    elevation_deg: float,
    size: tuple[int, int] = POSTER_SIZE,
) -> Camera:
    """Return the camera in this direction that sees all vertices in the middle of `FILLED` of its picture."""
    width, height = size
    focal = 0.5 * width / np.tan(np.radians(FIELD_OF_VIEW_DEG) / 2.0)
    reach = FILLED * np.array([width, height]) / (2.0 * focal)
    target = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    eye = position_around(target.tolist(), 1.0, azimuth_deg, elevation_deg)
    pose = look_at(eye.tolist(), target.tolist())
    turned = (vertices - target) @ pose[:3, :3]
    middle = np.zeros(2)
    # Perspective moves the middle; where it is settled to less than a pixel, the distance is too.
    for _ in range(_ROUNDS):
        aside = np.abs(turned[:, :2] - middle)
        distance = float((turned[:, 2] + (aside / reach).max(axis=1)).max())
        slopes = (turned[:, :2] - middle) / (distance - turned[:, 2:])
        middle = middle + 0.5 * distance * (slopes.min(axis=0) + slopes.max(axis=0)) / 2.0
    pose[:3, 3] = target + pose[:3, :3] @ np.array([*middle, distance])
    return Camera.centred("poster", width, height, float(focal), pose)


def studio(azimuth_deg: float) -> Environment:
    """Return the light of a studio for a camera at this azimuth: warm key, cool fill, rim, a white room.

    A white diffuse surface that faces the key reflects about 1.
    """
    directions = pixel_directions(64, 128)

    def box(aside_deg: float, elevation_deg: float, radius_deg: float) -> Float[ndarray, "rows columns 1"]:
        axis = position_around((0.0, 0.0, 0.0), 1.0, azimuth_deg + aside_deg, elevation_deg)
        apart = np.degrees(np.arccos(np.clip(directions @ axis, -1.0, 1.0)))
        return np.clip(radius_deg + 3.0 - apart, 0.0, 3.0)[..., None] / 3.0

    up = np.clip(0.5 + 0.5 * directions[..., 2:], 0.0, 1.0)
    radiance = (0.10 + 0.22 * up) * np.array([0.97, 1.0, 1.05])
    radiance += 7.0 * box(-48.0, 42.0, 19.0) * np.array([1.0, 0.95, 0.88])
    radiance += 1.1 * box(62.0, 18.0, 26.0) * np.array([0.88, 0.95, 1.06])
    radiance += 6.0 * box(160.0, 38.0, 14.0)
    return environment_from_array(radiance.astype(np.float32))


def _gain(picture: RelitPicture) -> float:
    """Return the factor that exposes the object, bounded: a black object stays dark, a white one light."""
    luminance = (picture.rgb @ np.array([0.2126, 0.7152, 0.0722]))[picture.opacity[..., 0] > 0.5]
    bright = float(np.percentile(luminance, BRIGHT)) if luminance.size else 0.0
    return float(np.clip(BRIGHT_LEVEL / max(bright, 1e-6), *GAINS))


def _backdrop(height: int, width: int) -> Float[ndarray, "height width 3"]:
    """Return the backdrop, sRGB-encoded: a wall that is lit in the middle, with noise against bands."""
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float64)
    apart = np.hypot((columns / width - 0.5) / 0.75, (rows / height - 0.52) / 0.85)
    share = np.clip(apart, 0.0, 1.0)[..., None] ** 1.6
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, (height, width, 1)) / 255.0
    return _BACKDROP_MIDDLE * (1.0 - share) + _BACKDROP_EDGE * share + noise
