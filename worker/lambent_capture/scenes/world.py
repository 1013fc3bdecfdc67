"""Working coordinates of a scene: object at the origin, of the size the method expects, upright.

The methods' numbers (contraction, hash grids, smoothness steps) are meant for an object of about 1.5 units
around the origin with z up. `SceneManifest.world_from_capture` records what was done to reach that.
"""

import numpy as np
from jaxtyping import Float64
from lambent_core.layouts import FIXED_WORLDS
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Pose64, Rotation64, Vector64
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import Capture

ORDINARY_REACH = {"cameras": 2.0, "silhouettes": 1.5}
"""Half the longest side of the box that a scene is scaled to, by where the box comes from; scene units."""
"""Layouts of published data whose coordinates are kept: the presets for them state distances in these."""
KEPT_RATIO = 2.0
"""A box that is off by less than this factor is left as it is, so that most captures keep their units."""
KEPT_OFFSET = 0.25
"""A box whose middle is off by less than this share of its half side is left where it is."""
FAR, FAR_RATIO = 1e4, 1e3
"""Cameras this far from the origin, in scene units and over their own spread, have map coordinates."""
ONE_SPOT = 1e-8
"""Cameras this close to each other, over their distance from the origin, stand on one spot: inverted ones."""
MAX_DISTANCE = 1e6
"""Between a camera and the middle of all, scene units; what is further away is a mistake."""
LEVEL_ENOUGH_DEG = 0.5
"""Captures that stand straighter than this are not turned."""
LEVEL_LIMIT = np.sin(np.radians(20.0))
"""Spread of the cameras' roll (sine) above which they do not tell where up is."""


def world_matrix(manifest: scene_pb2.SceneManifest) -> Pose64:
    """Return the similarity from the capture's own coordinates to those of the manifest."""
    if not manifest.world_from_capture:
        return np.eye(4)
    return np.array(manifest.world_from_capture).reshape(4, 4)


def rotation_and_scale(matrix: Pose64) -> tuple[Rotation64, float]:
    """Return the two factors of a similarity's linear part."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return matrix[:3, :3] / scale, scale


def move(manifest: scene_pb2.SceneManifest, matrix: Pose64) -> None:
    """Express everything in `manifest` in new coordinates, which a similarity gives from its present ones."""
    rotation, scale = rotation_and_scale(matrix)
    for frame in manifest.frames:
        pose = np.array(frame.camera.camera_to_world).reshape(4, 4)
        pose[:3, 3] = matrix[:3, :3] @ pose[:3, 3] + matrix[:3, 3]
        pose[:3, :3] = rotation @ pose[:3, :3]
        frame.camera.camera_to_world[:] = pose.ravel().tolist()
    if manifest.light_frame:
        manifest.light_frame[:] = (rotation @ np.array(manifest.light_frame).reshape(3, 3)).ravel().tolist()
    if manifest.bounds.minimum:
        low, high = np.array(manifest.bounds.minimum), np.array(manifest.bounds.maximum)
        middle = matrix[:3, :3] @ (0.5 * (low + high)) + matrix[:3, 3]
        half = np.abs(matrix[:3, :3]) @ (0.5 * (high - low))
        manifest.bounds.minimum[:] = (middle - half).tolist()
        manifest.bounds.maximum[:] = (middle + half).tolist()
    for ray_range in (manifest.primary_rays, manifest.secondary_rays):
        ray_range.near, ray_range.far = ray_range.near * scale, ray_range.far * scale
    manifest.contraction_radius *= scale
    manifest.world_from_capture[:] = (matrix @ world_matrix(manifest)).ravel().tolist()


def bring_near(capture: Capture, problems: Problems) -> Pose64:
    """Return the translation that took the cameras of `capture` from map coordinates to the origin.

    It is the identity for captures that are near the origin, which keep their coordinates. Frames whose
    cameras are further than `MAX_DISTANCE` from the middle of all are noted in `problems` and left out.
    """
    matrix = np.eye(4)
    if not capture.frames:
        return matrix
    poses = np.array([frame.camera.camera_to_world for frame in capture.frames]).reshape(-1, 4, 4)
    middle = np.median(poses[:, :3, 3], axis=0)
    away = np.linalg.norm(poses[:, :3, 3] - middle, axis=-1)
    from_origin, apart = float(np.linalg.norm(middle)), float(np.median(away))
    if from_origin > FAR and ONE_SPOT * from_origin < apart < from_origin / FAR_RATIO:
        matrix[:3, 3] = -middle
        poses[:, :3, 3] -= middle
        for frame, pose in zip(capture.frames, poses, strict=True):
            frame.camera.camera_to_world[:] = pose.ravel().tolist()
        if capture.box is not None:
            low, high = (tuple((np.array(corner) - middle).tolist()) for corner in capture.box)
            capture.box = (low, high)
    for frame, distance in zip(capture.frames, away, strict=True):
        if distance > MAX_DISTANCE:
            problems.error(
                "scene.camera_not_finite",
                f'the camera of frame "{frame.name}" stands {distance:.3g} units away from the middle of '
                f"all, more than {MAX_DISTANCE:g}; leave the frame out or solve its pose again",
                frame.name,
            )
    pairs = zip(capture.frames, away, strict=True)
    capture.frames = [frame for frame, distance in pairs if distance <= MAX_DISTANCE]
    return matrix


def in_world(manifest: scene_pb2.SceneManifest, matrix: Pose64) -> None:
    """Express `manifest` in the coordinates that `matrix` gives from the capture's own.

    For another look at a capture whose scene was trained in coordinates chosen then.
    """
    before = world_matrix(manifest)
    if not np.array_equal(before, matrix):
        move(manifest, matrix @ np.linalg.inv(before))


def settle(manifest: scene_pb2.SceneManifest) -> None:
    """Move the middle of the box to the origin and bring the box to the ordinary size, where it is far off.

    A scene that was moved already is brought there exactly. Afterwards the contraction of space begins at the
    box, or at the ball that the cameras suggest. Units that the capture fixes with its box, and the
    the fixed coordinates of some data sets, are kept.
    """
    low, high = np.array(manifest.bounds.minimum), np.array(manifest.bounds.maximum)
    middle, half = 0.5 * (low + high), float(0.5 * (high - low).max())
    matrix = np.eye(4)
    ordinary = ORDINARY_REACH.get(manifest.bounds_from, half)
    is_fixed = manifest.layout in FIXED_WORLDS
    is_moved = bool(manifest.world_from_capture) and not is_fixed
    if is_moved or not (is_fixed or 1.0 / KEPT_RATIO <= half / ordinary <= KEPT_RATIO):
        matrix[:3, :3] *= ordinary / half
    if is_moved or (not is_fixed and np.linalg.norm(middle) > KEPT_OFFSET * half):
        matrix[:3, 3] = -(matrix[:3, :3] @ middle)
    if not np.array_equal(matrix, np.eye(4)):
        move(manifest, matrix)
    low, high = np.array(manifest.bounds.minimum), np.array(manifest.bounds.maximum)
    if manifest.bounds_from == "cameras":
        reach = float(0.5 * (high - low).max())
        manifest.contraction_radius = reach + float(np.linalg.norm(0.5 * (low + high)))
    else:
        manifest.contraction_radius = float(np.abs([low, high]).max())


def stand_upright(
    manifest: scene_pb2.SceneManifest, problems: Problems, known_up: tuple[float, float, float] | None = None
) -> None:
    """Turn a scene whose layout leaves "up" open so that z points up: `known_up`, or how cameras were held.

    A camera held level has its right-hand axis (held upright: its upper one) in the horizontal plane, so "up"
    is the direction all of these are square to. Notes in `problems` when the cameras do not agree on one.
    """
    poses = np.array([frame.camera.camera_to_world for frame in manifest.frames]).reshape(-1, 4, 4)
    up = common_up(poses) if known_up is None else np.array(known_up)
    if up is None:
        problems.warning(
            "scene.up_unknown",
            "the cameras were not held level, so which way is up is unknown and the object may lie on "
            "its side under a new environment; turn the poses so that z points up",
        )
        return
    angle = np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if angle > LEVEL_ENOUGH_DEG:
        matrix = np.eye(4)
        matrix[:3, :3] = shortest_turn(up)
        move(manifest, matrix)


def common_up(poses: Float64[ndarray, "frames 4 4"]) -> Vector64 | None:
    """Return the unit direction that cameras held level (or upright) have in common as up.

    `poses` are camera-to-world, looking along -z. None where the cameras do not agree on one.
    """
    best: tuple[float, Float64[ndarray, 3]] | None = None
    for axis in (0, 1):
        values, vectors = np.linalg.eigh(poses[:, :3, axis].T @ poses[:, :3, axis] / len(poses))
        # With all axes in one line every direction square to it would do.
        if values[1] < 0.05 or np.sqrt(max(values[0], 0.0)) > LEVEL_LIMIT:
            continue
        up = vectors[:, 0]
        # Landscape: the cameras' own upper axis says which way. Portrait: objects are mostly seen from above.
        sign = poses[:, :3, 1 if axis == 0 else 2].mean(axis=0) @ up
        if abs(sign) > 1e-3 and (best is None or values[0] < best[0]):
            best = float(values[0]), up * np.sign(sign)
    return None if best is None else best[1]


def shortest_turn(up: Vector64) -> Rotation64:
    """Return the rotation that takes `up` to +z about the axis square to both."""
    if up[2] < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([up[1], -up[0], 0.0])  # up x z
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + up[2])
