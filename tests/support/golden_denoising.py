"""A small noisy picture and what the denoiser makes of it, for the readers of `tests/golden/denoising.json`.

PYTHONPATH=tests python -m support.golden_denoising     writes the file anew
"""

import json
from pathlib import Path

import numpy as np
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.denoising import denoised

GOLDEN = Path(__file__).parents[1] / "golden" / "denoising.json"
WIDTH, HEIGHT = 13, 11


def picture() -> RelitPicture:
    """Return a bent surface of two materials with a hole, half covered pixels, and noise of two strengths."""
    rng = np.random.default_rng(7)
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH]
    albedo = np.where((column < 6)[..., None], [0.6, 0.3, 0.2], [0.2, 0.25, 0.5])
    tilt = 0.05 * (row - 5.0)
    normal = np.stack([np.sin(tilt), 0.0 * tilt, np.cos(tilt)], axis=-1)
    noise = np.where(row < 4, 0.15, 0.03)[..., None]
    rgb = np.maximum(albedo + noise * rng.normal(size=albedo.shape), 0.0)
    coverage = np.ones((HEIGHT, WIDTH, 1))
    coverage[2:4, 8:10], coverage[:, 0] = 0.0, 0.5
    share = rng.uniform(0.4, 0.9, (HEIGHT, WIDTH, 1))
    one = np.ones_like(coverage)
    values = {
        "standard_error": noise * rng.uniform(0.5, 1.5, rgb.shape),
        "direct": share * rgb,
        "indirect": (1.0 - share) * rgb,
        "visibility": rng.uniform(0.0, 1.0, coverage.shape),
        "albedo": albedo,
        "normal": normal,
        "distance": 2.0 + 0.01 * (row + 0.5 * column)[..., None],
        "coverage": coverage,
    }
    single = {name: np.round(value, 5).astype(np.float32) for name, value in values.items()}
    # Readers have the parts, and add them up.
    single["rgb"] = single["direct"] + single["indirect"]
    others = ("opacity", "perceptual_roughness", "metalness", "depth")
    plain = {name: one.astype(np.float32) for name in others}
    parts = {"diffuse": single["direct"], "specular": single["indirect"]}
    return RelitPicture(**single, **plain, **parts, num_samples=8)


def numbers() -> dict[str, object]:
    """Return the picture's size and layers, and the denoised ones under "out"."""
    before = picture()
    after = denoised(before)

    def flat(array: np.ndarray) -> list[float]:
        return [float(f"{value:.6g}") for value in array.ravel()]

    layers = (
        "direct",
        "indirect",
        "standard_error",
        "visibility",
        "albedo",
        "normal",
        "distance",
        "coverage",
    )
    return {
        "width": WIDTH,
        "height": HEIGHT,
        **{name: flat(getattr(before, name)) for name in layers},
        "out": {name: flat(getattr(after, name)) for name in ("direct", "indirect", "visibility")},
    }


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(numbers()) + "\n", encoding="utf-8")
