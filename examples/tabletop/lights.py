"""Lights of the suite: rooms with windows and lamps, and an afternoon outside; linear radiance by direction.

The convention of the images is that of `sample_environments`.
"""

import numpy as np
from sample_environments import Radiance, image_of, lobe, mix, panel, smooth

from tabletop.patterns import noise


def _room(d: np.ndarray, wall: tuple, floor: tuple, ceiling: tuple, seed: int) -> np.ndarray:
    """Return a dim room: walls with pictures and shelves, darker towards the floor."""
    up = d[..., 2]
    cloud = noise(np.float32(d).reshape(-1, 3), 4.0, seed, 5).reshape(up.shape)
    radiance = mix(np.array(floor), np.array(wall), smooth(up, -0.42, -0.38))
    radiance = mix(radiance, np.array(ceiling), smooth(up, 0.60, 0.64))
    radiance = radiance * (0.75 + 0.35 * smooth(up, -0.5, 0.7) + 0.06 * cloud)[..., None]
    rng = np.random.default_rng(seed)
    for _ in range(16):
        at, high = rng.uniform(-180, 180), rng.uniform(-12, 24)
        wide, tall = rng.uniform(5, 26), rng.uniform(5, 22)
        ink = rng.uniform(0.03, 0.4) * (1.0 + rng.uniform(-0.35, 0.35, 3))
        area = panel(d, at, high, wide, tall)
        radiance = mix(radiance, ink * (1.0 + 0.3 * cloud)[..., None], area)
        radiance = mix(
            radiance,
            rng.uniform(0.02, 0.5) * (1.0 + rng.uniform(-0.4, 0.4, 3)),
            panel(d, at, high, 0.5 * wide, 0.5 * tall),
        )
    return radiance


def _window(d: np.ndarray, at: float, high: float, wide: float, tall: float, power: float) -> np.ndarray:
    """Return a window with a cross bar: sky above, a garden below."""
    area = (
        panel(d, at, high, wide, tall)
        - 0.9 * panel(d, at, high, 4.0, tall)
        - 0.9 * panel(d, at, high, wide, 4.0)
    )
    sky = mix(np.array([0.45, 0.5, 0.36]), np.array([0.82, 0.93, 1.1]), smooth(d[..., 2], 0.05, 0.35))
    return power * np.clip(area, 0.0, 1.0)[..., None] * sky


def sunny_room(d: np.ndarray) -> np.ndarray:
    """Return a living room whose window lets the sun in: hard shadows with a little softness."""
    radiance = _room(d, (0.34, 0.30, 0.24), (0.12, 0.08, 0.05), (0.42, 0.40, 0.36), 51)
    radiance = radiance + _window(d, 40.0, 34.0, 58.0, 46.0, 3.2) + _window(d, 150.0, 28.0, 30.0, 40.0, 1.8)
    sun = 2200.0 * lobe(d, 48.0, 44.0, 1600.0)
    return radiance + sun[..., None] * np.array([1.0, 0.88, 0.68])


def overcast_room(d: np.ndarray) -> np.ndarray:
    """Return a bright room with two windows and a lamp: soft shadows."""
    radiance = _room(d, (0.40, 0.40, 0.38), (0.16, 0.14, 0.12), (0.5, 0.5, 0.5), 52)
    radiance = radiance + _window(d, -60.0, 30.0, 70.0, 48.0, 4.5) + _window(d, 130.0, 26.0, 40.0, 40.0, 2.6)
    lamp = 14.0 * panel(d, 30.0, 66.0, 40.0, 9.0)
    return radiance + lamp[..., None] * np.array([1.0, 0.80, 0.55])


def kitchen(d: np.ndarray) -> np.ndarray:
    """Return a kitchen in the evening: warm lamps, a blue window."""
    radiance = _room(d, (0.26, 0.20, 0.14), (0.10, 0.07, 0.05), (0.36, 0.30, 0.22), 53)
    radiance = radiance + 0.6 * _window(d, 100.0, 22.0, 44.0, 34.0, 1.6) * np.array([0.6, 0.8, 1.3])
    for at, high, power in ((-20.0, 62.0, 34.0), (-110.0, 48.0, 18.0), (70.0, 74.0, 22.0)):
        radiance = radiance + (power * lobe(d, at, high, 90.0))[..., None] * np.array([1.0, 0.78, 0.5])
    return radiance


def studio_room(d: np.ndarray) -> np.ndarray:
    """Return a workshop with a strip light and a large window."""
    radiance = _room(d, (0.18, 0.19, 0.2), (0.07, 0.07, 0.07), (0.26, 0.26, 0.27), 54)
    radiance = radiance + _window(d, -140.0, 30.0, 64.0, 42.0, 5.0)
    strips = 16.0 * (panel(d, 20.0, 56.0, 70.0, 7.0) + panel(d, 20.0, 70.0, 80.0, 6.0))
    return radiance + strips[..., None] * np.array([0.95, 1.0, 1.0])


def terrace(d: np.ndarray) -> np.ndarray:
    """Return a terrace in the afternoon: sun, sky, a hedge and a house. Never used for photographs."""
    up = d[..., 2]
    cloud = noise(np.float32(d).reshape(-1, 3), 3.0, 55, 5).reshape(up.shape)
    sky = mix(np.array([0.80, 0.84, 0.88]), np.array([0.20, 0.36, 0.74]), smooth(up, 0.0, 0.8))
    sky = sky + (0.35 * smooth(cloud, 0.2, 1.0))[..., None]
    radiance = mix(np.array([0.30, 0.27, 0.22]), sky, smooth(up, -0.01, 0.01))
    hedge = np.array([0.05, 0.10, 0.03]) * (1.0 + 0.5 * cloud)[..., None]
    radiance = mix(radiance, hedge, panel(d, 60.0, 6.0, 150.0, 18.0))
    radiance = mix(radiance, np.array([0.62, 0.50, 0.38]), panel(d, -110.0, 18.0, 90.0, 40.0))
    sun = 420.0 * lobe(d, -40.0, 38.0, 1400.0)
    return radiance + sun[..., None] * np.array([1.0, 0.90, 0.72])


def lamps(d: np.ndarray) -> np.ndarray:
    """Return a dark room with a warm, a white and a blue lamp. Never used for photographs."""
    radiance = _room(d, (0.06, 0.055, 0.06), (0.04, 0.03, 0.03), (0.08, 0.08, 0.09), 56)
    for at, high, wide, power, ink in (
        (120.0, 40.0, 26.0, 9.0, (1.0, 0.62, 0.30)),
        (-60.0, 55.0, 22.0, 11.0, (1.0, 0.97, 0.92)),
        (-170.0, 18.0, 30.0, 4.0, (0.30, 0.50, 1.0)),
    ):
        radiance = radiance + (power * panel(d, at, high, wide, wide))[..., None] * np.array(ink)
    return radiance


LIGHTS: dict[str, Radiance] = {
    "sunny_room": sunny_room,
    "overcast_room": overcast_room,
    "kitchen": kitchen,
    "studio_room": studio_room,
    "terrace": terrace,
    "lamps": lamps,
}
UNSEEN = ("terrace", "lamps")


def light_image(name: str, height: int = 512) -> np.ndarray:
    """Return the light as float32 [height, 2 height, 3]."""
    return image_of(LIGHTS[name], height, oversampling=2)
