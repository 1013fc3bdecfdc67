import numpy as np
import torch
from flashcache.evaluation.relighting import MapLight
from flashcache.geometry.directions import direction_from_uv, environment_directions


def test_a_known_light_answers_with_its_pixels_at_their_centres_and_with_their_mean_between_them():
    image = np.random.default_rng(0).random((4, 8, 3), np.float32)
    light = MapLight.from_image(image, torch.device("cpu"))
    index = torch.zeros(32, dtype=torch.long)
    found = light(environment_directions(4, 8).reshape(-1, 3), index).reshape(4, 8, 3)
    torch.testing.assert_close(found, light.image, rtol=0.0, atol=1e-5)
    # Between the last column and the first, in the second row.
    seam = direction_from_uv(torch.tensor([[0.0, 1.5 / 4]]))
    torch.testing.assert_close(light(seam, index[:1])[0], 0.5 * (light.image[1, 7] + light.image[1, 0]))
