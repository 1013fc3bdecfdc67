"""Result of a layout's reader: frames and lights, before extents are chosen."""

from dataclasses import dataclass, field

from lambent_proto.v1 import scene_pb2

from lambent_capture.pictures.pictures import encoding_of
from lambent_capture.scenes.exposure import Exposure

LIGHT = "capture"
"""Name of the only light, for layouts that have none."""


def training_frame(picture: str, camera: scene_pb2.Camera | None = None) -> scene_pb2.Frame:
    """Return a frame of one photograph under the only light, which has no name yet."""
    image = scene_pb2.Image(light=LIGHT, path=picture, encoding=encoding_of(picture))
    return scene_pb2.Frame(split=scene_pb2.SPLIT_TRAIN, camera=camera, images=[image])


@dataclass(kw_only=True, slots=True)
class Capture:
    """A capture, frame by frame."""

    name: str
    frames: list[scene_pb2.Frame] = field(default_factory=list)
    lights: list[str] = field(default_factory=list)
    """Lights of the training frames; the first is the default one."""
    relight_lights: list[str] = field(default_factory=list)
    near_far: tuple[float, float] | None = None
    """Range of camera rays in scene units, where the capture states it."""
    box: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """Corners of a box around the object, where the capture states it."""
    up_is_z: bool = True
    """Whether z points up in the layout; otherwise it is `up`, or estimated from the cameras."""
    up: tuple[float, float, float] | None = None
    """Direction that points up, unit length, where it is known and not z."""
    object_only: bool = False
    """Whether the cameras surround the object closely and show nothing else."""
    has_cameras: bool = True
    """False for photographs whose cameras are still to be found."""
    exposures: dict[str, Exposure] = field(default_factory=dict)
    """By frame name, where the capture gives them separately from the pictures."""
    other_files: set[str] = field(default_factory=set)
    """Pictures that belong to the layout although no frame uses them."""
