"""Predictions made from the truth plus noise, written as an evaluation writes them."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
from lambent_core.scene import Scene, View
from lambent_run.report.predictions import (
    CACHE_FOLDER,
    DIRECT_FOLDER,
    UNSCALED_FOLDER,
    encoded,
    save_array,
)
from numpy import ndarray
from support.captures import REFERENCES


def reference_evaluation() -> ModuleType:
    """Return the reference metric script as a module."""
    spec = importlib.util.spec_from_file_location("reference_evaluate", REFERENCES / "evaluate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def noisy(values: ndarray, generator: np.random.Generator, width: float = 0.1) -> ndarray:
    """Return values with noise in 0..1."""
    return np.clip(values + generator.normal(0.0, width, values.shape), 0.0, 1.0)


def write_predictions(out: Path, scene: Scene, views: tuple[View, ...], seed: int = 0) -> None:
    """Write noisy copies of the truth of `views` below `out`; albedo is darker by a factor per channel."""
    generator = np.random.default_rng(seed)
    for view in views:
        folder = out / "pred" / view.name
        for light, image in view.images.items():
            rgb, alpha = noisy(image[..., :3], generator), noisy(image[..., 3:], generator, 0.02)
            save_array(folder / f"rgba_{light}.npy", encoded(rgb, alpha))
            other = CACHE_FOLDER if light in scene.lights else DIRECT_FOLDER
            save_array(out / other / view.name / f"rgba_{light}.npy", encoded(image[..., :3], alpha))
            if light in scene.relight_lights:
                save_array(out / UNSCALED_FOLDER / view.name / f"rgba_{light}.npy", encoded(rgb, alpha))
        write_surface(folder, view, generator)


def write_surface(folder: Path, view: View, generator: np.random.Generator) -> None:
    """Write noisy copies of the true maps of a view, or grey ones where it has none."""
    height, width, _ = next(iter(view.images.values())).shape
    grey = np.full((height, width, 1), 0.5)
    albedo = view.truth.get("albedo", np.repeat(grey, 4, axis=-1))
    darker = noisy(albedo[..., :3], generator, 0.03) * [0.8, 0.5, 0.6]
    save_array(folder / "albedo.npy", np.concatenate([darker, noisy(albedo[..., 3:], generator)], axis=-1))
    normal = view.truth.get("normal", np.zeros((height, width, 4)))
    turned = normal[..., :3] + generator.normal(0.0, 0.2, normal[..., :3].shape) * normal[..., 3:]
    turned[normal[..., 3] == 0.0] = [0.0, 0.0, 1.0]
    save_array(folder / "normal.npy", turned / np.linalg.norm(turned, axis=-1, keepdims=True))
    for kind in ("roughness", "metallic"):
        save_array(folder / f"{kind}.npy", noisy(view.truth.get(kind, grey), generator))
    save_array(folder / "distance.npy", view.truth.get("distance", grey) + 0.25)
