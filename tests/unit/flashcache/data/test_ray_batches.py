from dataclasses import replace

import numpy as np
import torch
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.presets import tiny
from lambent_core.scene import Camera, Margins, Scene, View
from support.lit_sphere import lit_sphere


def test_rays_go_through_the_centres_of_their_pixels():
    scene = lit_sphere(num_views=2, side=8)
    pixels = TrainingPixels(scene, tiny().pixels, torch.device("cpu"))
    # Row 2, column 5 of the second photograph.
    batch = pixels.at(torch.tensor([64 + 2 * 8 + 5]))
    camera = scene.train[1].camera
    pose = torch.from_numpy(camera.camera_to_world).float()
    local = pose[:3, :3].T @ batch.rays.directions[0]
    place = local[:2] / -local[2] * torch.tensor([camera.focal_x, -camera.focal_y])
    torch.testing.assert_close(place + 4.0, torch.tensor([5.5, 2.5]))


def cut(view: View, left: int, top: int, width: int, height: int) -> View:
    """Return the view cut to a box of its picture."""
    full = view.camera
    camera = Camera(
        width=width,
        height=height,
        focal_x=full.focal_x,
        focal_y=full.focal_y,
        centre_x=full.centre_x - left,
        centre_y=full.centre_y - top,
        camera_to_world=full.camera_to_world,
    )
    part = slice(top, top + height), slice(left, left + width)
    images = {light: picture[part] for light, picture in view.images.items()}
    clipped = {light: flags[part] for light, flags in view.clipped.items()}
    margins = Margins(left=left, top=top, right=full.width - left - width, bottom=full.height - top - height)
    return View(name=view.name, camera=camera, images=images, clipped=clipped, margins=margins)


def small_object(side: int = 24) -> Scene:
    """Return three views of a square object away from the middle, whose crops have different sizes."""
    scene = lit_sphere(num_views=3, side=side)
    views = []
    for index, view in enumerate(scene.train):
        (light, picture), *_ = view.images.items()
        alone = np.zeros_like(picture)
        alone[8 : 14 + index, 3:9] = [0.2, 0.4, 0.6, 1.0]
        views.append(replace(view, images={light: alone}))
    return replace(scene, train=tuple(views))


def test_a_cut_frame_is_drawn_from_as_if_it_were_whole():
    whole = small_object()
    cuts = [(2, 7, 8, 8), (3, 8, 7, 8), (0, 5, 10, 19)]
    crop = replace(whole, train=tuple(cut(v, *box) for v, box in zip(whole.train, cuts, strict=True)))
    choice = PixelChoice(dilation_px=4)
    batches = [
        TrainingPixels(scene, choice, torch.device("cpu")).draw(512, torch.Generator().manual_seed(1))
        for scene in (whole, crop)
    ]
    assert 0.1 < float(batches[0].coverage.mean()) < 0.9
    for name in ("colour", "coverage", "light_index"):
        torch.testing.assert_close(getattr(batches[1], name), getattr(batches[0], name))
    for name in ("origins", "directions", "near", "far"):
        torch.testing.assert_close(getattr(batches[1].rays, name), getattr(batches[0].rays, name))


def test_the_margins_of_a_cut_frame_are_not_stored():
    whole = small_object()
    crop = replace(whole, train=tuple(cut(view, 2, 7, 8, 9) for view in whole.train))
    pixels = TrainingPixels(crop, PixelChoice(), torch.device("cpu"))
    assert len(pixels.pixels) == 3 * 8 * 9
    assert pixels.num_positions == 3 * 24 * 24


def test_clipped_channels_come_with_their_rays_if_they_are_asked_for():
    scene = small_object()
    flags = np.zeros((24, 24, 3), dtype=bool)
    flags[10, 5, 1] = True
    first = replace(scene.train[0], clipped=dict.fromkeys(scene.lights, flags))
    crop = replace(scene, train=(cut(first, 2, 7, 8, 9), *scene.train[1:]))
    asked = TrainingPixels(crop, PixelChoice(clipped="at_least"), torch.device("cpu"))
    place = torch.tensor([10 * 24 + 5, 10 * 24 + 6, 24 * 24 + 10 * 24 + 5, 0])
    assert asked.at(place).clipped.tolist() == [[False, True, False], *3 * [3 * [False]]]
    assert asked.at(place).part(slice(0, 1)).clipped.tolist() == [[False, True, False]]
    assert TrainingPixels(crop, PixelChoice(), torch.device("cpu")).at(place).clipped is None
