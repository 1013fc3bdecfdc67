import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.presets import tiny
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
