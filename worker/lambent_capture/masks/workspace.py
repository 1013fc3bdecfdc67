"""The intermediate results of an estimate, kept so that a person's corrections need not start again."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float16
from lambent_core.errors import WorkerError
from numpy import ndarray

from lambent_capture.arrays import Marks, Reduced32, Rgb, Vector64
from lambent_capture.masks.consensus import ConsensusSettings, MaskView
from lambent_capture.masks.lattice import Frame
from lambent_capture.scenes.picture_camera import PictureCamera

VERSION = 2
_ABOUT = "estimate.json"
_ARRAYS = "estimate.npz"


@dataclass(frozen=True, kw_only=True, slots=True)
class Workspace:
    """Pictures at the size of the evidence, and everything that is known about them before corrections."""

    names: tuple[str, ...]
    cameras: tuple[PictureCamera, ...]
    """In pixels of the photographs."""
    pictures: tuple[Rgb, ...]
    """sRGB, reduced."""
    support_odds: tuple[Float16[ndarray, "height width"], ...]
    """Log odds that a pixel of `pictures` does not show the support; 0 where nothing is known."""
    learnt: tuple[Reduced32, ...]
    beyond: tuple[Reduced32, ...]
    """How much a pixel counts when colours are learnt, and if it sees past the support: `evidence.Known`."""
    beliefs: tuple[Reduced32, ...]
    """Probability of the object, at the size at which views are compared."""
    priors: tuple[Reduced32, ...]
    """What other views say about a pixel, log odds, at that size."""
    frame: Frame
    low: Vector64
    high: Vector64
    """Corners of the box that is searched, in coordinates of `frame`."""
    found_low: Vector64
    found_high: Vector64
    """Corners of the box around what was found."""
    centre: Vector64
    """Point that the cameras look at, scene units."""
    distance: float
    """Of the cameras from it."""
    has_support: bool
    """Whether a plane was found that the object stands on."""
    rounds: ConsensusSettings
    """How the views were compared when the object was found."""
    reason: str = ""
    """Why nothing was found at all; empty where something was."""
    seeds: dict[int, Marks] = field(default_factory=dict)
    """What a person marked in some views, 1 object and -1 background; not saved."""

    def view(self, number: int) -> MaskView:
        """Return a view at the size of the evidence."""
        picture = self.pictures[number]
        camera = self.cameras[number].resized(picture.shape[1], picture.shape[0])
        return MaskView(self.names[number], picture, camera)

    def save(self, folder: Path) -> None:
        """Write `estimate.json` and `estimate.npz` into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        arrays: dict[str, ndarray] = {}
        for name in _PER_VIEW:
            for number, values in enumerate(getattr(self, name)):
                arrays[f"{name}_{number}"] = values
        arrays |= {name: getattr(self, name) for name in _VECTORS}
        arrays |= {"frame_origin": self.frame.origin, "frame_axes": self.frame.axes}
        arrays["camera_to_world"] = np.array([camera.camera_to_world for camera in self.cameras])
        np.savez(folder / _ARRAYS, allow_pickle=False, **arrays)
        about = {
            "version": VERSION,
            "names": self.names,
            "distance": self.distance,
            "has_support": self.has_support,
            "rounds": asdict(self.rounds),
            "reason": self.reason,
            "cameras": [{name: getattr(camera, name) for name in _OF_CAMERA} for camera in self.cameras],
        }
        (folder / _ABOUT).write_text(json.dumps(about, indent=1), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> "Workspace":
        """Return what `save` wrote; raises `WorkerError` where it is missing or of another version."""
        try:
            about = json.loads((folder / _ABOUT).read_text(encoding="utf-8"))
            if about["version"] != VERSION:
                raise WorkerError(
                    "scene.mask_estimate_stale",
                    f'"{folder}" holds an estimate of version {about["version"]}, this release reads version '
                    f"{VERSION}; estimate the masks again",
                )
            with np.load(folder / _ARRAYS) as arrays:
                return cls._from(about, dict(arrays))
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise WorkerError(
                "scene.mask_estimate_stale",
                f'"{folder}" holds no estimate that can be corrected; estimate the masks again',
            ) from error

    @classmethod
    def _from(cls, about: dict, arrays: dict[str, ndarray]) -> "Workspace":
        poses = arrays["camera_to_world"]
        cameras = tuple(_camera(each, pose) for each, pose in zip(about["cameras"], poses, strict=True))
        per_view: dict[str, Any] = {
            name: tuple(arrays[f"{name}_{number}"] for number in range(len(cameras))) for name in _PER_VIEW
        }
        vectors: dict[str, Any] = {name: arrays[name] for name in _VECTORS}
        return cls(
            names=tuple(about["names"]),
            cameras=cameras,
            frame=Frame(origin=arrays["frame_origin"], axes=arrays["frame_axes"]),
            **vectors,
            distance=about["distance"],
            has_support=about["has_support"],
            rounds=ConsensusSettings(
                **about["rounds"] | {"refit_after": tuple(about["rounds"]["refit_after"])}
            ),
            reason=about["reason"],
            **per_view,
        )


def _camera(record: dict[str, Any], pose: ndarray) -> PictureCamera:
    figures: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in record.items()
    }
    return PictureCamera(**figures, camera_to_world=pose)


_OF_CAMERA = ("width", "height", "focal", "centre", "distortion")
_PER_VIEW = ("pictures", "support_odds", "learnt", "beyond", "beliefs", "priors")
_VECTORS = ("low", "high", "found_low", "found_high", "centre")
