"""The findings about the cameras of photographs, and how it is kept in a folder."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from jaxtyping import Float
from lambent_core.files import read_record, write_json
from numpy import ndarray

from lambent_capture.poses.model import camera_poses

RECORD = "solution.json"
MODEL = Path("sparse") / "0"


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """Why a photograph was left out from the start."""

    code: str
    """Of a finding."""
    message: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Solution:
    """Cameras found by COLMAP; the world's scale is arbitrary."""

    names: tuple[str, ...]
    """All photographs."""
    features: tuple[int, ...]
    """Points that were found in each."""
    partners: dict[str, tuple[str, int]]
    """For each photograph that has one, the one it fits best and the points they have in common."""
    camera_to_world: dict[str, Float[ndarray, "4 4"]]
    """Of the photographs whose cameras were found; axes x right, y down, z forward in the stored picture."""
    faults: dict[str, Fault]
    """Photographs that could not be used."""
    other_models: tuple[tuple[str, ...], ...] = ()
    """Photographs that fit together, but not to those of the largest model."""
    num_points: int = 0
    reprojection_error_px: float = 0.0
    """Mean distance of points from where they are seen, work pixels."""
    field_deg: float = 0.0
    """Field of view of the widest lens along the longer side."""
    up: tuple[float, float, float] | None = None
    """The direction that points up, always z; None where the cameras do not tell."""
    up_turns: tuple[int, ...] = ()
    """Of each of `names`: quarter turns clockwise from the stored picture's upper side to where up was."""
    still_share: float = 0.0
    """Median share of the other photographs with which a photograph shares a background that stands still."""
    static_background: bool = False
    """Whether background and camera stood still while the object moved, as on a turntable."""
    nothing_moved: bool = False
    """Whether the photographs show one and the same view."""
    flat_share: float = 0.0
    """Share of the pairs that a single plane, or a camera that only turned, would explain."""
    model: Path | None = None
    """Folder of COLMAP's binary model of the original files, at full size; None where no camera was found."""

    def save(self, folder: Path) -> None:
        """Write everything but the cameras, which the model in `folder` holds, to `folder`."""
        values: dict[str, Any] = {
            name: getattr(self, name)
            for name in self.__dataclass_fields__
            if name not in ("camera_to_world", "model", "faults")
        }
        values["faults"] = {name: asdict(fault) for name, fault in self.faults.items()}
        values["has_model"] = self.model is not None
        write_json(folder / RECORD, values)

    @classmethod
    def load(cls, folder: Path) -> "Solution | None":
        """Return what `save` wrote to `folder`, or None where there is nothing whole."""
        values = read_record(folder / RECORD)
        if not values:
            return None
        model = folder / MODEL if values.pop("has_model") else None
        for name in ("names", "features", "up_turns"):
            values[name] = tuple(values[name])
        values["up"] = tuple(values["up"]) if values["up"] else None
        values["other_models"] = tuple(tuple(names) for names in values["other_models"])
        values["partners"] = {name: (other, n) for name, (other, n) in values["partners"].items()}
        values["faults"] = {name: Fault(**fault) for name, fault in values["faults"].items()}
        poses = {} if model is None else camera_poses(pycolmap.Reconstruction(model))
        return cls(**values, camera_to_world=poses, model=model)


def mean_error_px(model: Any) -> float:
    """Return the mean reprojection error of a model over all observations, in its pixels."""
    points = [(point.error, point.track.length()) for point in model.points3D.values()]
    errors, weights = np.array(points).reshape(-1, 2).T
    return float(np.average(errors, weights=weights)) if len(points) else 0.0
