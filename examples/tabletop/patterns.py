"""Procedural pictures and paints: noise in space and in the plane, print, checks."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage


def noise(p: np.ndarray, frequency: float, seed: int, octaves: int = 3) -> np.ndarray:
    """Return smooth noise at points [n, 3], about -1 to 1; each octave has half the amplitude."""
    lattice = np.random.default_rng(seed).uniform(-1.0, 1.0, (64, 64, 64)).astype(np.float32)
    total = np.zeros(len(p), np.float32)
    for octave in range(octaves):
        where = (p * np.float32(frequency * 2**octave) + np.float32(7.3 * octave)).T
        total += 0.5**octave * ndimage.map_coordinates(lattice, where, order=1, mode="grid-wrap")
    return total


def plane_noise(height: int, width: int, sigma: float, seed: int) -> np.ndarray:
    """Return noise [height, width] with unit variance, smooth over `sigma` pixels, periodic."""
    rng = np.random.default_rng(seed)
    shrink = max(1, int(sigma / 3))
    small = rng.normal(size=(height // shrink + 1, width // shrink + 1)).astype(np.float32)
    soft = ndimage.gaussian_filter(small, sigma / shrink, mode="wrap")
    soft = ndimage.zoom(soft, shrink, order=1)[:height, :width] if shrink > 1 else soft[:height, :width]
    return soft / soft.std()


def linear(hex_colour: str) -> np.ndarray:
    """Return the linear colour of an sRGB one like "d0402a"."""
    code = np.array([int(hex_colour[k : k + 2], 16) for k in (0, 2, 4)]) / 255.0
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(np.float32)


def mixed(low: np.ndarray, high: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return colours between two; `share` [...] of the second, clipped to [0, 1]."""
    return low + (high - low) * np.clip(share, 0.0, 1.0)[..., None]


def printed(
    width: int, height: int, seed: int, *, paper: str = "f2f0ea", picture_share: float = 0.35
) -> np.ndarray:
    """Return a printed page [height, width, 3], linear: headings, columns of made-up text, charts."""
    rng = np.random.default_rng(seed)
    page = Image.new("RGB", (width, height), f"#{paper}")
    draw = ImageDraw.Draw(page)
    margin, columns = width // 24, 3
    column = (width - margin * (columns + 1)) // columns
    heading, body = width // 22, max(8, width // 95)
    draw.text((margin, margin * 0.7), _words(rng, 4).title(), "#202028", ImageFont.load_default(heading))
    font = ImageFont.load_default(body)
    for k in range(columns):
        left, y = margin + k * (column + margin), margin + int(1.6 * heading)
        while y < height - margin - body:
            if rng.uniform() < picture_share * 0.12:
                tall = int(min(column * rng.uniform(0.4, 0.8), height - margin - y))
                _chart(draw, rng, left, y, column, tall)
                y += tall + body
            else:
                draw.text((left, y), _words(rng, 14)[: int(column / body * 2.0)], "#26262c", font)
                y += int(1.5 * body) * (2 if rng.uniform() < 0.12 else 1)
    code = np.asarray(page, np.float32) / 255.0
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _words(rng: np.random.Generator, count: int) -> str:
    syllables = ["ba", "do", "ker", "li", "mon", "pe", "ra", "sti", "tu", "ven", "wa", "zo", "nim", "gal"]
    return " ".join("".join(rng.choice(syllables, rng.integers(1, 4))) for _ in range(count))


def _chart(draw: ImageDraw.ImageDraw, rng: np.random.Generator, x: int, y: int, w: int, h: int) -> None:
    inks = ["#c23b2e", "#2e6fb0", "#e0a526", "#3c8f57", "#5c4a8a", "#20242a"]
    draw.rectangle([x, y, x + w, y + h], fill=str(rng.choice(["#e3ddcf", "#d7e2ea", "#efe6c8", "#30343c"])))
    for k in range(int(rng.integers(5, 12))):
        ink = inks[int(rng.integers(len(inks)))]
        cx, cy = x + w * rng.uniform(0.1, 0.9), y + h * rng.uniform(0.15, 0.85)
        size = h * rng.uniform(0.05, 0.22)
        corners = [max(cx - size, x), max(cy - size, y), min(cx + size, x + w), min(cy + size, y + h)]
        if k % 3 == 0:
            draw.ellipse(corners, fill=ink)
        elif k % 3 == 1:
            draw.rectangle(corners, fill=ink)
        else:
            draw.line([cx, cy, x + w * rng.uniform(), y + h * rng.uniform()], fill=ink, width=max(2, w // 60))
