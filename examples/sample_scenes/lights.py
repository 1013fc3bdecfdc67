"""Environments of the other scenes, linear radiance as a function of direction (see `sample_environments`).

Spot lamps and the sun are discs of one or two degrees, so these maps are 512 x 256 pixels.
"""

import numpy as np
from sample_environments import ENVIRONMENTS, Radiance, image_of, lobe, mix, panel, smooth
from tabletop.patterns import noise

HEIGHT = 256


def disc(direction: np.ndarray, azimuth_deg: float, elevation_deg: float, diameter_deg: float) -> np.ndarray:
    """Return 1 inside a disc of `diameter_deg` around a direction, 0 outside, with a sharp edge."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    axis = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    return (direction @ axis > np.cos(np.radians(0.5 * diameter_deg))).astype(float)


def interior(direction: np.ndarray, wall: tuple, floor: tuple, ceiling: tuple, seed: int) -> np.ndarray:
    """Return a room without lamps: walls with doors and pictures, a floor, a ceiling."""
    up = direction[..., 2]
    cloud = noise(np.float32(direction).reshape(-1, 3), 3.0, seed, 4).reshape(up.shape)
    radiance = mix(np.array(floor), np.array(wall), smooth(up, -0.36, -0.33))
    radiance = mix(radiance, np.array(ceiling), smooth(up, 0.66, 0.69)) * (1.0 + 0.12 * cloud)[..., None]
    rng = np.random.default_rng(seed)
    for azimuth_deg in rng.uniform(-180, 180, 10):
        ink = rng.uniform(0.3, 1.9) * np.array(wall) * (1.0 + rng.uniform(-0.5, 0.5, 3))
        area = panel(direction, azimuth_deg, rng.uniform(-8, 24), rng.uniform(8, 34), rng.uniform(10, 30))
        radiance = mix(radiance, ink, area)
    return radiance


def spotlights(direction: np.ndarray) -> np.ndarray:
    """Return a dim room with three studio lamps of 1.2 to 1.8 degrees that carry most of the light."""
    radiance = 0.5 * interior(direction, (0.11, 0.10, 0.095), (0.07, 0.055, 0.045), (0.13, 0.13, 0.135), 61)
    for azimuth_deg, elevation_deg, diameter_deg, power, colour in (
        (-55.0, 38.0, 1.6, 3300.0, (1.0, 0.90, 0.74)),
        (100.0, 24.0, 1.8, 1700.0, (0.86, 0.93, 1.0)),
        (-160.0, 58.0, 1.2, 2300.0, (1.0, 0.97, 0.92)),
    ):
        lamp = disc(direction, azimuth_deg, elevation_deg, diameter_deg)
        radiance = radiance + (power * lamp)[..., None] * np.array(colour)
    return radiance


def drawing_room(direction: np.ndarray) -> np.ndarray:
    """Return a room in daylight: two tall windows, a standing lamp, pictures on green walls."""
    radiance = interior(direction, (0.22, 0.27, 0.20), (0.20, 0.13, 0.08), (0.50, 0.48, 0.43), 62)
    outside = mix(
        np.array([0.55, 0.62, 0.42]), np.array([1.0, 1.12, 1.30]), smooth(direction[..., 2], 0.0, 0.3)
    )
    for azimuth_deg, power in ((20.0, 6.5), (66.0, 5.5)):
        area = panel(direction, azimuth_deg, 26.0, 26.0, 54.0)
        bars = panel(direction, azimuth_deg, 26.0, 3.4, 54.0) + panel(direction, azimuth_deg, 34.0, 26.0, 3.4)
        radiance = radiance + power * np.clip(area - bars, 0.0, 1.0)[..., None] * outside
    lamp = 26.0 * lobe(direction, -128.0, 30.0, 150.0)
    return radiance + lamp[..., None] * np.array([1.0, 0.74, 0.44])


def garage(direction: np.ndarray) -> np.ndarray:
    """Return a garage with two strip lights and an open door."""
    radiance = interior(direction, (0.16, 0.16, 0.17), (0.09, 0.09, 0.09), (0.22, 0.22, 0.22), 63)
    strips = panel(direction, -70.0, 58.0, 90.0, 6.0) + panel(direction, 110.0, 62.0, 110.0, 6.0)
    door = panel(direction, 165.0, 10.0, 60.0, 36.0)
    sky = mix(np.array([0.5, 0.46, 0.40]), np.array([0.75, 0.88, 1.05]), smooth(direction[..., 2], 0.02, 0.2))
    return radiance + 15.0 * strips[..., None] * np.array([0.92, 1.0, 0.95]) + 2.6 * door[..., None] * sky


def _sky(direction: np.ndarray, zenith: tuple, horizon: tuple, ground: tuple, seed: int) -> np.ndarray:
    up = direction[..., 2]
    cloud = noise(np.float32(direction).reshape(-1, 3), 3.0, seed, 5).reshape(up.shape)
    sky = mix(np.array(horizon), np.array(zenith), smooth(up, 0.0, 0.75))
    sky = sky + (0.25 * smooth(cloud, 0.3, 1.0) * smooth(up, 0.02, 0.3))[..., None]
    near = np.array(ground) * (1.0 + 0.25 * cloud)[..., None]
    return mix(near, sky, smooth(up, -0.01, 0.01))


def garden(direction: np.ndarray) -> np.ndarray:
    """Return a garden at noon: a sun of one degree in a blue sky, hedges, a house wall."""
    radiance = _sky(direction, (0.14, 0.30, 0.74), (0.66, 0.80, 0.98), (0.13, 0.15, 0.07), 64)
    radiance = mix(radiance, np.array([0.05, 0.10, 0.03]), panel(direction, 150.0, 4.0, 170.0, 16.0))
    radiance = mix(radiance, np.array([0.72, 0.62, 0.50]), panel(direction, -40.0, 16.0, 70.0, 34.0))
    sun = 16000.0 * disc(direction, 35.0, 47.0, 1.0)
    return radiance + sun[..., None] * np.array([1.0, 0.93, 0.80])


def harbour(direction: np.ndarray) -> np.ndarray:
    """Return an evening by the water: a low, wide, orange glow, a violet sky, lit windows."""
    radiance = _sky(direction, (0.10, 0.12, 0.32), (0.62, 0.36, 0.34), (0.06, 0.08, 0.12), 65)
    glow = 7.0 * lobe(direction, 120.0, 6.0, 18.0) + 60.0 * lobe(direction, 120.0, 8.0, 400.0)
    radiance = radiance + glow[..., None] * np.array([1.0, 0.48, 0.18])
    for azimuth_deg in (-150.0, -118.0, -96.0, -60.0, -31.0):
        radiance = radiance + 2.4 * panel(direction, azimuth_deg, 9.0, 9.0, 12.0)[..., None] * np.array(
            [1.0, 0.72, 0.36]
        )
    return radiance


def overcast(direction: np.ndarray) -> np.ndarray:
    """Return a grey sky over a yard, brightest overhead: no shadows to speak of."""
    up = direction[..., 2]
    cloud = noise(np.float32(direction).reshape(-1, 3), 2.0, 66, 4).reshape(up.shape)
    sky = (0.45 + 0.65 * smooth(up, 0.0, 1.0) + 0.12 * cloud)[..., None] * np.array([0.93, 0.97, 1.0])
    radiance = mix(np.array([0.14, 0.12, 0.10]), sky, smooth(up, -0.01, 0.01))
    radiance = mix(radiance, np.array([0.30, 0.16, 0.11]), panel(direction, 80.0, 14.0, 110.0, 36.0))
    return mix(radiance, np.array([0.10, 0.15, 0.12]), panel(direction, -100.0, 9.0, 60.0, 24.0))


LIGHTS: dict[str, Radiance] = {
    "spotlights": spotlights,
    "drawing_room": drawing_room,
    "garage": garage,
    "garden": garden,
    "harbour": harbour,
    "overcast": overcast,
    "studio": ENVIRONMENTS["studio"],
    "sunset": ENVIRONMENTS["sunset"],
}


def light_image(name: str, height: int = HEIGHT) -> np.ndarray:
    """Return the light as float32 [height, 2 height, 3]."""
    return image_of(LIGHTS[name], height, oversampling=4)
