"""Reads the float maps of an evaluation, and says where the object is."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from lambent_core.scene import View
from numpy import ndarray


def load(out: Path, folder: str, view: View, name: str) -> Float[ndarray, "height width channels"] | None:
    """Return a predicted map as float64, or None where it was not rendered."""
    path = out / folder / view.name / f"{name}.npy"
    return np.load(path, allow_pickle=False).astype(np.float64) if path.is_file() else None


def object_mask(view: View) -> Bool[ndarray, "height width"]:
    """Return where the object is: alpha above 0 in the first map that has one."""
    for kind in ("albedo", "normal"):
        if kind in view.truth:
            return view.truth[kind][..., 3] > 0.0
    return next(iter(view.images.values()))[..., 3] > 0.0
