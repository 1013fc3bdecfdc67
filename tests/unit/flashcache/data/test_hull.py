"""The visual hull holds the object, tolerates wrong masks, and leaves no pixel of a mask without cells."""

from dataclasses import replace

import numpy as np
import torch
from flashcache.data.hull import fit_occupancy, hull_of
from flashcache.data.ray_batches import TrainingPixels
from flashcache.encoding.occupancy import Occupancy, OccupancyConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from lambent_core.scene import Scene
from support.lit_sphere import RADIUS, lit_domain, lit_sphere

CONFIG = OccupancyConfig(cells=32)
CPU = torch.device("cpu")


def middles(scene: Scene) -> np.ndarray:
    """Return the distances of the cells' middles from the origin."""
    low, high = np.array(scene.bounds_min), np.array(scene.bounds_max)
    axes = [low[i] + (np.arange(32) + 0.5) * (high[i] - low[i]) / 32 for i in range(3)]
    return np.linalg.norm(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), axis=-1)


def with_masks(scene: Scene, change) -> Scene:
    """Return the scene with `change(number, coverage)` for the coverage of each training view."""
    views = []
    for number, view in enumerate(scene.train):
        picture = view.images["sky"].copy()
        picture[..., 3] = change(number, picture[..., 3])
        views.append(replace(view, images={"sky": picture}))
    return replace(scene, train=tuple(views))


def test_the_hull_holds_the_sphere_and_not_much_more():
    scene = lit_sphere(num_views=16, side=64)
    hull, away = hull_of(scene, CONFIG), middles(scene)
    assert hull is not None
    assert hull[away < RADIUS].all()
    size = (scene.bounds_max[0] - scene.bounds_min[0]) / 32
    assert not hull[away > RADIUS + 5.0 * size].any()


def test_empty_masks_do_not_cut_the_object_and_few_hardly_let_the_hull_grow():
    scene = lit_sphere(num_views=16, side=64)
    away, size = middles(scene), (scene.bounds_max[0] - scene.bounds_min[0]) / 32
    for count in (2, 10):
        wrong = with_masks(scene, lambda number, mask, count=count: mask * (number >= count))
        hull = hull_of(wrong, CONFIG)
        assert hull is not None
        assert hull[away < RADIUS].all()
        if count == 2:
            assert not hull[away > RADIUS + 5.0 * size].any()


def test_every_pixel_of_every_mask_meets_a_cell():
    generator = np.random.default_rng(0)

    def noisy(number: int, mask: np.ndarray) -> np.ndarray:
        return (
            mask * (generator.uniform(size=mask.shape) > 0.3 * (number % 2)) if number else np.eye(64) * 1.0
        )

    scene = with_masks(lit_sphere(num_views=10, side=64), noisy)
    hull = hull_of(scene, replace(CONFIG, dissent=0.0, margin_px=0.0))
    assert hull is not None
    occupancy = Occupancy(scene.bounds_min, scene.bounds_max, 32)
    occupancy.set(torch.from_numpy(hull))
    pixels = TrainingPixels(scene, tiny().pixels, CPU)
    batch = pixels.at(torch.arange(pixels.num_positions))
    narrow = occupancy.narrowed(batch.rays)
    # A ray may cut off a corner of the box, or of a cell, between two steps.
    shown = (batch.coverage > 0.5) & (batch.rays.far - batch.rays.near > 0.2)
    assert bool((narrow.far > narrow.near)[shown].all())


def test_photographs_without_masks_have_no_hull():
    scene = with_masks(lit_sphere(num_views=4), lambda number, mask: np.ones_like(mask))
    assert hull_of(scene, CONFIG) is None


def test_a_model_has_no_density_outside_and_pixels_that_meet_nothing_are_not_drawn():
    scene = lit_sphere(num_views=8, side=48)
    config = tiny()
    model = InverseModel(replace(config.model, occupancy=CONFIG), lit_domain(scene))
    fit_occupancy(model, scene)
    points = torch.tensor([[0.0, 0.0, 0.0], [0.9, 0.9, 0.9]])
    for field in (*model.nerf.proposals, model.nerf.density):
        density = field.density(points)
        assert density[0] > 0.0
        assert density[1] == 0.0
        assert field.with_gradient(points)[0].density[1] == 0.0
    occupancy = model.nerf.occupancy
    assert occupancy is not None
    pixels = TrainingPixels(scene, config.pixels, CPU, occupancy)
    narrow = occupancy.narrowed(pixels.draw(500, torch.Generator().manual_seed(0)).rays)
    assert bool((narrow.far > narrow.near).all())
    covered = sum(int((view.images["sky"][..., 3] > 0.0).sum()) for view in scene.train)
    assert covered <= len(pixels.meeting) < 0.8 * pixels.num_positions


def test_a_mask_without_half_of_the_object_cuts_nothing():
    scene = lit_sphere(num_views=16, side=64)

    def halved(number: int, mask: np.ndarray) -> np.ndarray:
        return mask * (np.arange(mask.shape[1]) < mask.shape[1] // 2) if number == 3 else mask

    hull = hull_of(with_masks(scene, halved), CONFIG)
    assert hull is not None
    assert hull[middles(scene) < RADIUS].all()


def test_where_masks_agree_one_view_past_the_object_is_enough():
    """A disc, seen from its side in one photograph of seventeen: the others do not see what is under it."""
    scene = lit_sphere(num_views=16, side=64)
    *above, side = sorted(scene.train, key=lambda view: -abs(view.camera.position[2]))
    scene = replace(scene, train=(*(2 * above[:8]), side))
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    disc = (RADIUS * np.linspace(0.0, 1.0, 100)[:, None, None] * ring).reshape(-1, 3)

    def shown(number: int, mask: np.ndarray) -> np.ndarray:
        camera = scene.train[number].camera
        world_to_camera = np.linalg.inv(camera.camera_to_world)
        local = disc @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
        column = (camera.centre_x - camera.focal_x * local[:, 0] / local[:, 2]).astype(int)
        row = (camera.centre_y + camera.focal_y * local[:, 1] / local[:, 2]).astype(int)
        found = np.zeros_like(mask)
        found[row, column] = 1.0
        return found

    with_side = with_masks(scene, shown)
    hulls = [hull_of(one, CONFIG) for one in (with_side, replace(with_side, train=with_side.train[:-1]))]
    thick, thicker = (hull[16, 16].sum() for hull in hulls if hull is not None)
    assert 1 <= thick < 0.7 * thicker


def test_masks_may_be_wrong_by_the_margin_and_no_more():
    """Each pixel of margin lets the hull of a ball grow by a pixel's width at the ball."""
    scene = lit_sphere(num_views=16, side=64)
    volumes = [int(hull_of(scene, replace(CONFIG, margin_px=margin)).sum()) for margin in (0.0, 2.0, 6.0)]
    camera = scene.train[0].camera
    pixel = np.linalg.norm(camera.position) / camera.focal_x
    edge = [(3.0 * volume / (4.0 * np.pi)) ** (1.0 / 3.0) for volume in volumes]
    cell = (scene.bounds_max[0] - scene.bounds_min[0]) / 32
    assert (edge[1] - edge[0]) * cell > 0.5 * 2.0 * pixel
    assert (edge[2] - edge[0]) * cell > 0.5 * 6.0 * pixel
