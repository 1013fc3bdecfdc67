"""Write tests/golden/light_*.json: numbers of lighting that Python and TypeScript must both reproduce.

    python scripts/golden_light.py [--check]

The inputs are stored with the results, so that another implementation needs nothing else. With --check the
files are compared, and the exit code is 1 where they differ by more than rounding.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.directions import normalise, pixel_directions
from lambent_relight.baked import split_sum
from lambent_relight.environment import axes as environment_axes
from lambent_relight.environment import dominant_lights, harmonics, prefilter
from lambent_relight.environment.maps import Environment

GOLDEN = Path(__file__).resolve().parent.parent / "tests" / "golden"
LEVELS = 5


def rounded(values: Any, digits: int = 8) -> Any:
    """Return nested lists with `digits` significant digits."""
    return [
        float(f"{value:.{digits}g}") if np.ndim(value) == 0 else rounded(value, digits) for value in values
    ]


def sample_map(height: int, width: int) -> np.ndarray:
    """Return a map whose values are exact in a few digits: a gradient, a checked ground and a small sun."""
    directions = pixel_directions(height, width)
    sky = 0.5 + 0.25 * directions[..., 2]
    row, column = np.indices((height, width))
    image = np.stack([sky, 0.8 * sky + 0.1, 0.2 + 0.05 * ((row // 2 + column // 2) % 2)], axis=-1)
    image[height // 4, width // 5] = (60.0, 45.0, 30.0)
    image[height // 4, width // 5 + 1] = (30.0, 22.5, 15.0)
    return np.round(image, 3).astype(np.float32)


def some_directions(count: int, seed: int) -> np.ndarray:
    return np.round(normalise(np.random.default_rng(seed).normal(size=(count, 3))), 9)


def harmonics_numbers() -> dict[str, Any]:
    """Return basis values, a projection, its turned forms, and cosine factors."""
    light = Environment(sample_map(8, 16))
    directions = normalise(some_directions(6, 1))
    angle, tilt = 0.7, -1.1
    about_z = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    matrix = about_x @ about_z
    coefficients = harmonics.project(light, 7)
    # Turned in any way: the harmonics whose values are those of the straight ones at directions turned back.
    points = some_directions(400, 3)
    values = harmonics.basis(points @ matrix, 7) @ coefficients
    rotated = np.linalg.lstsq(harmonics.basis(points, 7), values, rcond=None)[0]
    return {
        "about": "Real orthonormal harmonics, index l(l+1)+m, 7 bands; a map and its coefficients.",
        "directions": rounded(directions, 12),
        "basis": rounded(harmonics.basis(directions, 7)),
        "map": rounded(light.radiance, 6),
        "coefficients": rounded(coefficients),
        "rotate_deg": 33.0,
        "coefficients_turned": rounded(harmonics.project(light.rotated(33.0), 7)),
        "matrix": rounded(matrix, 12),
        "coefficients_rotated": rounded(rotated),
        "cosine_factors": rounded(harmonics.cosine_factors(7)),
    }


def prefilter_numbers() -> dict[str, Any]:
    """Return look-ups in five levels of a map."""
    light = Environment(sample_map(8, 16))
    levels = prefilter.prefilter(light, LEVELS).rotated(20.0)
    directions = normalise(some_directions(12, 2))
    roughness = np.array([0.0, 0.1, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75, 0.85, 0.95, 1.0])
    return {
        "about": f"Radiance seen through GGX lobes: {LEVELS} levels, the light turned by 20 degrees.",
        "map": rounded(light.radiance, 6),
        "num_levels": LEVELS,
        "rotate_deg": 20.0,
        "level_widths": [level.shape[1] for level in levels.levels],
        "directions": rounded(directions, 12),
        "perceptual_roughness": roughness.tolist(),
        "radiance": rounded(levels.lookup(directions, roughness), 7),
    }


def split_sum_numbers() -> dict[str, Any]:
    """Return (scale, bias) at some cosines and roughnesses."""
    pairs = [
        [0.0, 0.5],
        [0.02, 0.1],
        [0.1, 0.0],
        [0.25, 0.3],
        [0.5, 1.0],
        [0.66, 0.45],
        [0.9, 0.8],
        [1.0, 0.2],
    ]
    scale, bias = split_sum.split_sum(*np.array(pairs).T)
    return {
        "about": "Specular reflectance under even light is F0 scale + bias; [cosine, perceptual roughness].",
        "inputs": pairs,
        "scale": rounded(scale, 7),
        "bias": rounded(bias, 7),
        "table_corner": rounded(split_sum.table()[[0, 0, 31, 31], [0, 31, 0, 31]], 7),
    }


def dominant_numbers() -> dict[str, Any]:
    """Return the lights of a map with two suns, and figures of the residual."""
    image = sample_map(16, 32)
    image[10:12, 20:22] = (5.0, 8.0, 20.0)
    light = Environment(image)
    lights = dominant_lights.split(light, 3)
    return {
        "about": "Peaks as directional lights with the default rule, at most three.",
        "map": rounded(image, 6),
        "directions": rounded(lights.directions),
        "radiance_solid_angle": rounded(lights.radiance_solid_angle),
        "energy": rounded(dominant_lights.energy(image)),
        "residual_energy": rounded(dominant_lights.energy(lights.residual.radiance)),
        "residual_rows": rounded(lights.residual.radiance.sum(axis=(1, 2), dtype=np.float64)),
    }


def axes_numbers() -> dict[str, Any]:
    """Return the directions in our world of single lit pixels in other programs' maps."""
    cases = []
    for axes in environment_axes.QUARTER_TURNS:
        for row, column in ((3, 1), (4, 6), (1, 11)):
            image = np.zeros((8, 16, 3), np.float32)
            image[row, column] = 1.0
            ours = environment_axes.from_axes(Environment(image), axes).radiance[..., 0]
            brightest = np.unravel_index(int(np.argmax(ours)), ours.shape)
            direction = rounded(pixel_directions(8, 16)[brightest])
            cases.append({"axes": axes, "row": row, "column": column, "direction": direction})
    return {
        "about": "Lit pixels of 8 x 16 maps in other layouts, and where they shine from.",
        "cases": cases,
    }


def numbers() -> dict[str, dict[str, Any]]:
    """Return the content of every file by its name."""
    return {
        "light_harmonics": harmonics_numbers(),
        "light_prefilter": prefilter_numbers(),
        "light_split_sum": split_sum_numbers(),
        "light_dominant": dominant_numbers(),
        "light_axes": axes_numbers(),
    }


def equal(actual: Any, expected: Any) -> bool:
    """Return whether two contents agree, numbers within 1e-6 of each other and of their size."""
    if isinstance(expected, dict):
        return actual.keys() == expected.keys() and all(equal(actual[k], expected[k]) for k in expected)
    if isinstance(expected, list):
        return len(actual) == len(expected) and all(map(equal, actual, expected))
    if isinstance(expected, float):
        return abs(actual - expected) <= 1e-6 * max(1.0, abs(expected))
    return actual == expected


def main(arguments: list[str]) -> int:
    """Write or compare the files and return the exit code."""
    wrong = []
    for name, content in numbers().items():
        path = GOLDEN / f"{name}.json"
        if "--check" not in arguments:
            path.write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")
        elif not equal(json.loads(path.read_text(encoding="utf-8")), content):
            wrong.append(f"{path.name} differs; run python scripts/golden_light.py and look at the change")
    print("\n".join(wrong) or "golden numbers of lighting are up to date")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
