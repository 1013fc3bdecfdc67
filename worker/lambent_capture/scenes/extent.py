"""Chooses where in space the object is looked for, from the cameras and from what the capture says."""

import numpy as np
from jaxtyping import Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Vector64
from lambent_capture.scenes.capture import Capture

HELD_OUT_EVERY = 8


def looked_at_point(
    positions: Float64[ndarray, "cameras 3"], directions: Float64[ndarray, "cameras 3"]
) -> Vector64 | None:
    """Return the point nearest to all optical axes (least squares), or None where the axes are parallel.

    `positions` are in scene units, `directions` are unit vectors along which the cameras look.
    """
    projectors = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    total = projectors.sum(axis=0)
    if np.linalg.cond(total) > 1e6:
        return None
    return np.linalg.solve(total, (projectors @ positions[:, :, None]).sum(axis=0)[:, 0])


def stand_apart(positions: Float64[ndarray, "cameras 3"], centre: Vector64) -> bool:
    """Return whether most cameras have different places, seen from the point they look at."""
    from_middle = np.linalg.norm(positions - np.median(positions, axis=0), axis=-1)
    return bool(np.median(from_middle) > 0.1 * np.median(np.linalg.norm(positions - centre, axis=-1)))


def camera_axes(
    frames: list[scene_pb2.Frame],
) -> tuple[Float64[ndarray, "cameras 3"], Float64[ndarray, "cameras 3"]]:
    """Return positions (scene units) and unit viewing directions of the cameras of `frames`."""
    poses = np.array([frame.camera.camera_to_world for frame in frames]).reshape(-1, 4, 4)
    return poses[:, :3, 3], -poses[:, :3, 2]


def hold_out(frames: list[scene_pb2.Frame]) -> None:
    """Make every eighth frame a test frame where the capture brings none; the first stays for training."""
    if any(frame.split == scene_pb2.SPLIT_TEST for frame in frames):
        return
    for frame in frames[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY]:
        frame.split = scene_pb2.SPLIT_TEST


def set_extent(manifest: scene_pb2.SceneManifest, capture: Capture) -> None:
    """Fill in bounds, ray ranges and the contraction radius, all in scene units, from what headers tell.

    With r the median distance of the cameras from the point they look at: space is contracted beyond r/2, the
    box reaches r/2 from that point, camera rays run from 0.1 r to 4 r (0.5 r to 1.5 r where nothing but the
    object is in the pictures, `capture.object_only`), secondary rays from 0.0125 r to r/2. For the
    published TensoIR-synthetic scenes (r = 4) these are the paper's settings. What the capture states goes
    first.
    """
    positions, directions = camera_axes(list(manifest.frames))
    centre = looked_at_point(positions, directions)
    centre = np.zeros(3) if centre is None else centre
    # Six digits: the last bits of the least squares solution are noise and would only look like information.
    rig = float(f"{np.median(np.linalg.norm(positions - centre, axis=-1)):.6g}")
    centre = np.round(centre / rig, 6) * rig if rig > 0.0 else centre
    if rig <= 0.0:
        return
    reach = 0.5 * rig
    # The contraction is centred on the origin, so an off-centre object needs a larger uncontracted ball.
    manifest.contraction_radius = reach + float(np.linalg.norm(centre))
    low, high = capture.box or (tuple(centre - reach), tuple(centre + reach))
    if capture.box:
        # A stated box is where all detail is: the grids cover exactly the cube around it.
        manifest.contraction_radius = float(np.abs([low, high]).max())
    manifest.bounds_from = "capture" if capture.box or capture.object_only else "cameras"
    manifest.bounds.minimum[:] = [float(v) for v in low]
    manifest.bounds.maximum[:] = [float(v) for v in high]
    near, far = capture.near_far or (
        (0.5 * rig, 1.5 * rig) if capture.object_only else (0.1 * rig, 4.0 * rig)
    )
    manifest.primary_rays.near, manifest.primary_rays.far = near, far
    manifest.secondary_rays.near, manifest.secondary_rays.far = 0.025 * reach, reach


def set_fitted_box(manifest: scene_pb2.SceneManifest, low: Vector64, high: Vector64) -> None:
    """Replace the bounds by a box around the object; secondary rays get the paper's share of its size.

    With h half the longest side they run from h/30 to 4 h/3: 0.05 to 2 for an object of the published scenes'
    size (h = 1.5).
    """
    half = float(0.5 * (high - low).max())
    manifest.bounds_from = "silhouettes"
    manifest.bounds.minimum[:] = low.tolist()
    manifest.bounds.maximum[:] = high.tolist()
    manifest.secondary_rays.near, manifest.secondary_rays.far = half / 30.0, 4.0 * half / 3.0
    manifest.contraction_radius = float(np.abs([low, high]).max())
