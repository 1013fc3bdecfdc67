"""Three procedural environments for the sample scene, linear radiance as a function of direction.

World is z up. Image convention: row 0 looks along +z, column W/2 along +x, azimuth falls to the right
(pixel (r, c) of HxW looks along azimuth pi - 2 pi (c + .5) / W and elevation pi/2 - pi (r + .5) / H).
Every map is scaled to a mean radiance of `MEAN_RADIANCE` over the sphere, so that exposure 1 suits all three.
"""

from collections.abc import Callable

import numpy as np

MEAN_RADIANCE = 0.42

Radiance = Callable[[np.ndarray], np.ndarray]


def directions(height: int, width: int) -> np.ndarray:
    """Return the unit direction [height, width, 3] that each pixel's centre looks along."""
    azimuth = np.pi - 2.0 * np.pi * (np.arange(width) + 0.5) / width
    elevation = np.pi / 2.0 - np.pi * (np.arange(height) + 0.5) / height
    azimuth, elevation = np.meshgrid(azimuth, elevation)
    flat = np.cos(elevation)
    return np.stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)], axis=-1)


def smooth(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return 0 below `low`, 1 above `high` and a cubic in between."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def mix(low: np.ndarray, high: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return colours between `low` and `high`, `weight` [...] being the share of `high`."""
    return low + (high - low) * weight[..., None]


def lobe(direction: np.ndarray, azimuth_deg: float, elevation_deg: float, sharpness: float) -> np.ndarray:
    """Return exp(sharpness (cos - 1)) around a direction: 1 at its middle."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    axis = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    return np.exp(sharpness * (direction @ axis - 1.0))


def panel(
    direction: np.ndarray, azimuth_deg: float, elevation_deg: float, width_deg: float, height_deg: float
) -> np.ndarray:
    """Return 1 inside a rectangle of azimuth and elevation, 0 outside, with edges three degrees soft."""
    azimuth = np.degrees(np.arctan2(direction[..., 1], direction[..., 0]))
    elevation = np.degrees(np.arcsin(np.clip(direction[..., 2], -1.0, 1.0)))
    across = np.abs((azimuth - azimuth_deg + 180.0) % 360.0 - 180.0)
    along = np.abs(elevation - elevation_deg)
    soft = 1.5
    return (1.0 - smooth(across, width_deg / 2 - soft, width_deg / 2 + soft)) * (
        1.0 - smooth(along, height_deg / 2 - soft, height_deg / 2 + soft)
    )


def morning(direction: np.ndarray) -> np.ndarray:
    """Return a blue sky with a soft sun above a street of coloured houses: the light of the photographs."""
    up = direction[..., 2]
    sky = mix(np.array([0.75, 0.82, 0.90]), np.array([0.16, 0.32, 0.72]), smooth(up, 0.0, 0.9))
    ground = mix(np.array([0.26, 0.21, 0.16]), np.array([0.13, 0.12, 0.11]), smooth(-up, 0.0, 0.8))
    radiance = mix(ground, sky, smooth(up, -0.01, 0.01))
    houses = [
        (-160, 30, 22, (0.55, 0.20, 0.12)),
        (-120, 26, 34, (0.62, 0.52, 0.30)),
        (-72, 34, 18, (0.16, 0.30, 0.22)),
        (-20, 24, 40, (0.45, 0.42, 0.40)),
        (24, 30, 26, (0.70, 0.36, 0.16)),
        (96, 40, 16, (0.22, 0.24, 0.42)),
        (140, 22, 30, (0.66, 0.62, 0.55)),
    ]
    for azimuth_deg, width_deg, height_deg, colour in houses:
        radiance = mix(
            radiance, np.array(colour), panel(direction, azimuth_deg, height_deg / 2, width_deg, height_deg)
        )
    cloud = 0.5 * lobe(direction, 150, 45, 14.0) + 0.4 * lobe(direction, -60, 60, 20.0)
    sun = 60.0 * lobe(direction, 60, 42, 220.0) + 1.2 * lobe(direction, 60, 42, 12.0)
    return radiance + cloud[..., None] + sun[..., None] * np.array([1.0, 0.88, 0.68])


def studio(direction: np.ndarray) -> np.ndarray:
    """Return a dark room with three soft boxes: never seen in training."""
    up = direction[..., 2]
    radiance = mix(np.array([0.06, 0.055, 0.05]), np.array([0.10, 0.11, 0.13]), smooth(up, -0.5, 0.7))
    boxes = [
        (-35, 38, 50, 34, 9.0, (1.0, 0.93, 0.82)),
        (120, 24, 26, 56, 6.0, (0.72, 0.86, 1.0)),
        (-150, 60, 70, 22, 4.0, (1.0, 1.0, 1.0)),
    ]
    for azimuth_deg, elevation_deg, width_deg, height_deg, power, colour in boxes:
        glow = panel(direction, azimuth_deg, elevation_deg, width_deg, height_deg)
        radiance = radiance + power * glow[..., None] * np.array(colour)
    return radiance


def sunset(direction: np.ndarray) -> np.ndarray:
    """Return a low orange sun under a violet sky: never seen in training."""
    up = direction[..., 2]
    west = lobe(direction, -130, 4, 2.2)
    horizon = mix(np.array([0.30, 0.20, 0.34]), np.array([1.25, 0.52, 0.18]), west)
    sky = mix(horizon, np.array([0.08, 0.09, 0.24]), smooth(up, 0.0, 0.75))
    ground = mix(np.array([0.10, 0.07, 0.06]), np.array([0.30, 0.14, 0.07]), west)
    radiance = mix(ground, sky, smooth(up, -0.01, 0.01))
    bands = 0.5 + 0.5 * np.sin(40.0 * up + 2.0 * direction[..., 0])
    radiance = radiance + (0.25 * bands * west * smooth(up, 0.02, 0.2))[..., None] * np.array([1.0, 0.4, 0.3])
    return radiance + (45.0 * lobe(direction, -130, 12, 160.0))[..., None] * np.array([1.0, 0.50, 0.18])


ENVIRONMENTS: dict[str, Radiance] = {"morning": morning, "studio": studio, "sunset": sunset}


def environment_image(name: str, height: int = 64) -> np.ndarray:
    """Return the environment `name` as float32 [height, 2 height, 3]."""
    return image_of(ENVIRONMENTS[name], height, oversampling=4)


def image_of(light: Radiance, height: int, oversampling: int) -> np.ndarray:
    """Return a light as float32 [height, 2 height, 3], each pixel averaged over its area."""
    image = np.empty((height, 2 * height, 3))
    fine = directions(height * oversampling, 2 * height * oversampling)
    # Row by row: the whole of a large map does not fit into memory at this resolution.
    for row in range(height):
        strip = light(fine[row * oversampling : (row + 1) * oversampling])
        image[row] = strip.reshape(oversampling, 2 * height, oversampling, 3).mean(axis=(0, 2))
    solid_angle = np.cos(np.pi / 2.0 - np.pi * (np.arange(height) + 0.5) / height)
    mean = (image.mean(axis=(1, 2)) * solid_angle).sum() / solid_angle.sum()
    return (image * (MEAN_RADIANCE / mean)).astype(np.float32)


def lookup(image: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return `image` at each `direction` [..., 3], bilinear between pixel centres, clamped at the poles."""
    height, width = image.shape[:2]
    azimuth = np.arctan2(direction[..., 1], direction[..., 0])
    elevation = np.arcsin(np.clip(direction[..., 2], -1.0, 1.0))
    column = (np.pi - azimuth) / (2.0 * np.pi) * width - 0.5
    row = np.clip((np.pi / 2.0 - elevation) / np.pi * height - 0.5, 0.0, height - 1.0)
    left, top = np.floor(column).astype(int), np.minimum(np.floor(row).astype(int), height - 2)
    across, down = (column - left)[..., None], (row - top)[..., None]
    left, right = left % width, (left + 1) % width
    above = image[top, left] * (1 - across) + image[top, right] * across
    below = image[top + 1, left] * (1 - across) + image[top + 1, right] * across
    return above * (1 - down) + below * down
