"""Exposure of photographs whose files do not say it, or say it wrongly: from points that several show.

Offsets are in EV: by how much a photograph is brighter than the others show the same points.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from lambent_core.layouts import BENCHMARKS
from lambent_core.measured import measured
from lambent_proto.v1 import capture_pb2, scene_pb2
from numpy import ndarray

from lambent_capture.problems import Problems

NOISE_SHARE = 0.33
"""Standard deviation of an estimated offset over the median mismatch, where the true offsets are 0: 0.12 on
the sample scene, 0.33 on a diffuse crate, 0.31 on polished metal."""
LEAST_NOISE_EV = 0.03
"""The noise is not taken for smaller than this."""
LEAST_SHARE = 0.5
"""Share of an offset that must be left after shrinking for any of it to count."""
CONTRADICTED = 0.25
"""Files contradict their pictures where without what they say at most this share of the variance is left."""
"""Data sets whose exposure is fixed, and known to be."""


def even_out_exposure(
    manifest: scene_pb2.SceneManifest, figures: capture_pb2.CaptureFigures, problems: Problems
) -> None:
    """Change `Frame.exposure` where the pictures clearly show that it is wrong, and note that in `problems`.

    `figures` were measured with the exposures that `manifest` has now, and with masks. Only captures under
    one light are evened out: under several, what a change of light does looks like a change of exposure.
    """
    if len(manifest.lights) != 1 or manifest.layout in BENCHMARKS or not figures.has_hull:
        return
    by_name = {view.name: view for view in figures.views}
    if any(frame.name not in by_name or not by_name[frame.name].pictures for frame in manifest.frames):
        return
    views = [by_name[frame.name] for frame in manifest.frames]
    left = np.array([view.pictures[0].exposure_ev for view in views])
    noise = max(LEAST_NOISE_EV, NOISE_SHARE * float(np.median([view.mismatch_ev for view in views])))
    if believed_share(left, noise) < LEAST_SHARE:
        return
    stated = np.array([frame.exposure or 1.0 for frame in manifest.frames])
    without = left - np.log2(stated)
    if np.ptp(stated) > 0.0 and without.var() < CONTRADICTED * left.var():
        problems.warning(
            "scene.exposure_contradicted",
            "the photographs say that they were exposed differently (by up to "
            f"{measured(np.ptp(np.log2(stated)), 1)} EV), but show the same points equally bright, so what "
            "they say is not used; check whether their brightness was changed afterwards or their EXIF was "
            "copied",
        )
        stated, left = np.ones_like(stated), without
    share = believed_share(left, noise)
    if share >= LEAST_SHARE:
        stated = stated * np.exp2(-share * left)
        _note_estimate(manifest, share * left, problems)
    for frame, factor in zip(manifest.frames, stated / stated[0], strict=True):
        frame.exposure = float(factor)


def believed_share(offsets: Float64[ndarray, " views"], noise: float) -> float:
    """Return the share 0..1 of measured offsets that is true, given the standard deviation of their noise.

    Source: James and Stein's estimator, 1 - noise^2 / variance, not below 0.
    """
    variance = float(np.var(offsets))
    return max(0.0, 1.0 - noise**2 / variance) if variance > 0.0 else 0.0


def adopt_exposures(frames: Sequence[scene_pb2.Frame], trained: Sequence[scene_pb2.Frame]) -> None:
    """Give frames the exposure that a run was trained with, if all of them are frames of its capture."""
    known = {frame.name: frame for frame in trained}
    same = all(
        frame.name in known
        and np.allclose(frame.camera.camera_to_world, known[frame.name].camera.camera_to_world, atol=1e-3)
        for frame in frames
    )
    for frame in frames if same else ():
        frame.exposure = known[frame.name].exposure


def _note_estimate(
    manifest: scene_pb2.SceneManifest, offsets: Float64[ndarray, " views"], problems: Problems
) -> None:
    brightest, darkest = int(offsets.argmax()), int(offsets.argmin())
    problems.warning(
        "scene.exposure_estimated",
        f"the same points of the object differ by {measured(np.ptp(offsets), 1)} EV between photographs, "
        f'from "{manifest.frames[darkest].name}" to "{manifest.frames[brightest].name}", which is taken for '
        "a change of exposure and evened out; fixed exposure and white balance give better colours",
        manifest.frames[brightest].name,
    )
