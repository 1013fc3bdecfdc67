"""Leaves out frames whose pictures are missing or broken, where most of a capture is sound.

instant-ngp's own capture of a fox names 67 frames and has 50 pictures. Other programs leave such frames out.
"""

from collections.abc import Mapping

from lambent_proto.v1 import scene_pb2

from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import SHOWN, listed
from lambent_capture.scenes.rig import MIN_TRAIN_FRAMES


def are_few(num_lost: int, num_kept: int) -> bool:
    """Return whether the rest makes up for the lost pictures: they are at most half, and three are left."""
    return num_lost <= num_kept and num_kept >= MIN_TRAIN_FRAMES


def without_pictures(
    frames: list[scene_pb2.Frame], broken: Mapping[str, scene_pb2.Finding], problems: Problems
) -> list[scene_pb2.Frame]:
    """Return the frames that use no picture in `broken`; what is wrong with those goes to `problems`."""
    kept = []
    for frame in frames:
        paths = [image.path for image in frame.images if image.path in broken]
        if not paths:
            kept.append(frame)
        for path in paths:
            problems.lost(broken[path].code, broken[path].message, path)
    return kept


def settle_lost(frames: list[scene_pb2.Frame], problems: Problems) -> set[str]:
    """Turn lost pictures into one note of each kind if they are few; return their paths.

    `frames` are those that are left. Lost pictures that are many stay errors.
    """
    total = problems.num_lost + len(frames)
    if not problems.num_lost or not are_few(problems.num_lost, len(frames)):
        return set()
    lost = problems.forgive_lost()
    missing = [finding.subject for finding in lost if finding.code == "scene.file_missing"]
    broken = [finding for finding in lost if finding.code != "scene.file_missing"]
    if missing:
        problems.warning(
            "scene.frames_without_picture",
            f"{len(missing)} of {total} frames have no picture and are left out: {listed(missing)}; add the "
            "pictures if they should be used",
            missing[0],
        )
    if broken:
        more = f"; and {len(broken) - SHOWN} more" if len(broken) > SHOWN else ""
        said = "; ".join(finding.message for finding in broken[:SHOWN])
        problems.warning(
            "scene.pictures_left_out",
            f"{len(broken)} of {total} pictures cannot be used, and their frames are left out: {said}{more}",
            broken[0].subject,
        )
    return {finding.subject for finding in lost}
