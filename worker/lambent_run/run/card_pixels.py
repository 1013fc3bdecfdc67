"""The pixels of a grey card among those that are trained on, and checks whether they can be used."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from flashcache.evaluation.gbuffer import camera_rays
from flashcache.physical.model import InverseModel
from flashcache.polish.grey_card import LEAST_SAMPLES, Card
from flashcache.polish.polish import MOST_LIGHTS
from flashcache.presets import preset
from jaxtyping import Bool
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import camera_of, load_scene, turned
from lambent_capture.pictures.lens import distorted
from lambent_capture.pictures.upright import turned_size, upright_turns
from lambent_core.layouts import PHOTOGRAPHS
from lambent_core.measured import measured
from lambent_core.scene import Scene, View
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_run.run.card_option import GreyCard, fits, is_named, outside, refused

OPAQUE = 0.99
LEAST_INSIDE = 0.5
"""Share of the card's pixels that must lie inside the mask, and share of those that must not be clipped."""
SLACK_PX = 1e-3


def check_grey_card(card: GreyCard, scene: Scene, manifest: scene_pb2.SceneManifest) -> None:
    """Raise `UsageError` where the card cannot be used with this capture; for before the training."""
    if scene.turned:
        raise refused(
            "light_turns",
            "the light turned from photograph to photograph, and then materials are not fitted once more, "
            "which a card needs",
        )
    if len(scene.lights) > MOST_LIGHTS:
        raise refused(
            "many_lights",
            f"there are {len(scene.lights)} training lights, and a card needs {MOST_LIGHTS} at most",
        )
    card_pixels(card, scene, manifest)


def check_in_capture(
    card: GreyCard, folder: Path, layout: str | None, masks: Path | None, left_out: Sequence[str]
) -> None:
    """Raise `UsageError` where the card cannot be used in a capture that has cameras, at the usual size.

    The arguments are those of `describe_scene`. Only the card's photograph is read.
    """
    manifest = describe_scene(folder, layout, masks, left_out)
    frame, _ = frame_of(card, manifest)
    only = scene_pb2.Frame()
    only.CopyFrom(frame)
    del manifest.frames[:]
    manifest.frames.append(only)
    config = preset("fast")
    scene = load_scene(folder, manifest, max_side=config.max_side, crop=config.crop)
    card_pixels(card, scene, manifest)


def card_of(card: GreyCard, scene: Scene, manifest: scene_pb2.SceneManifest, model: InverseModel) -> Card:
    """Return the rays through the card's pixels; raises `UsageError` as `check_grey_card` does."""
    view, inside = card_pixels(card, scene, manifest)
    device = next(model.parameters()).device
    index = torch.from_numpy(np.flatnonzero(inside)).to(device)
    return Card(camera_rays(model, view.camera, device).select(index), card.reflectance)


def card_pixels(
    card: GreyCard, scene: Scene, manifest: scene_pb2.SceneManifest
) -> tuple[View, Bool[ndarray, "height width"]]:
    """Return the view that shows the card, and which of its pixels lie wholly on it and on the object.

    Raises `UsageError` where there are too few, most are outside the mask, or most are clipped.
    """
    frame, image = frame_of(card, manifest)
    turns = box_turns(card, frame, manifest)
    view = next(view for view in (*scene.train, *scene.test) if view.name == frame.name)
    on_card, total = _inside_box(frame, view, card, turns)
    if total < LEAST_SAMPLES:
        raise refused(
            "box_small",
            f"the box covers {total} whole pixels of the photograph at the size it is trained on, and at "
            f"least {LEAST_SAMPLES} are needed; give a larger part of the card, or a larger --set max_side",
        )
    on_object = on_card & (view.images[image.light][..., 3] > OPAQUE)
    if on_object.sum() < max(LEAST_INSIDE * total, LEAST_SAMPLES):
        raise refused(
            "outside_mask",
            f"{measured(100.0 * on_object.sum() / total)} % of the card lie on what is reconstructed, for "
            "the mask "
            f'of "{card.photograph}" leaves the rest out; put the card onto the object, or bring it into the '
            "mask (lambent masks --edit, --masks)",
        )
    clipped = view.clipped.get(image.light)
    if clipped is not None and clipped[on_object].any(axis=-1).mean() > LEAST_INSIDE:
        raise refused(
            "clipped",
            f'the card is overexposed in "{card.photograph}"; choose another photograph, or expose less',
        )
    return view, on_object


def frame_of(card: GreyCard, manifest: scene_pb2.SceneManifest) -> tuple[scene_pb2.Frame, scene_pb2.Image]:
    """Return the frame and picture of the card; raises `UsageError` where no used one, or several, fit."""
    matches = [
        (frame, image)
        for frame in manifest.frames
        for image in frame.images
        if is_named(image.path, card.photograph)
    ]
    if not matches:
        raise refused(
            "photograph_unused",
            f'"{card.photograph}" is none of the photographs that are used: it was left out, does not '
            f"show the object, or shows another light than {', '.join(manifest.lights)}",
        )
    if len(matches) > 1:
        paths = ", ".join(image.path for _, image in matches[:3])
        raise refused("photograph_ambiguous", f'"{card.photograph}" could be {paths}; give the path')
    return matches[0]


def box_turns(card: GreyCard, frame: scene_pb2.Frame, manifest: scene_pb2.SceneManifest) -> int:
    """Return how many quarter turns to the left make the photograph upright.

    Raises `UsageError` for a box that is not wholly inside it.
    """
    upright = manifest.layout == PHOTOGRAPHS
    turns = upright_turns(camera_of(frame).camera_to_world) if upright else 0
    stored = _stored(frame)
    size = turned_size((stored.width, stored.height), turns)
    if not fits(card, size):
        raise outside(card, size)
    return turns


def _stored(frame: scene_pb2.Frame) -> scene_pb2.Camera | scene_pb2.Lens:
    """Return what the photograph was taken with, as its file stores it."""
    return frame.camera.lens if frame.camera.HasField("lens") else frame.camera


def _inside_box(
    frame: scene_pb2.Frame, view: View, card: GreyCard, turns: int
) -> tuple[Bool[ndarray, "height width"], int]:
    """Return which pixels of `view` lie wholly inside the box, and how many of the uncut frame do."""
    lying = turned(view, -turns)
    camera, margins = lying.camera, lying.margins
    # Corners of all pixels of the frame, those that were cut off around the view included.
    columns = np.arange(-margins.left, camera.width + margins.right + 1)
    rows = np.arange(-margins.top, camera.height + margins.bottom + 1)
    x, y = np.meshgrid(
        (columns - camera.centre_x) / camera.focal_x, (rows - camera.centre_y) / camera.focal_y
    )
    stored = _stored(frame)
    if isinstance(stored, scene_pb2.Lens):
        x, y = distorted(x, y, np.array(stored.distortion))
    x, y = stored.focal_x * x + stored.centre_x, stored.focal_y * y + stored.centre_y
    width, height = stored.width, stored.height
    for _ in range(turns):
        x, y = y, width - x
        width, height = height, width
    left, top, across, down = card.box
    corner = (x >= left - SLACK_PX) & (x <= left + across + SLACK_PX)
    corner &= (y >= top - SLACK_PX) & (y <= top + down + SLACK_PX)
    inside = corner[:-1, :-1] & corner[1:, :-1] & corner[:-1, 1:] & corner[1:, 1:]
    shown = inside[margins.top : margins.top + camera.height, margins.left : margins.left + camera.width]
    return np.rot90(shown, turns), int(inside.sum())
