"""A ball and pictures of it, for tests of the polish."""

import torch
from flashcache.physical.model import InverseModel
from lambent_core.scene import Scene
from support import lit_sphere
from support.sphere_model import RADIUS, sphere_model


def pictures_of_the_model() -> Scene:
    """Return 14 views of 40 x 40 pixels of the ball that `trained_ball` shows; its edge is soft."""
    before = lit_sphere.RADIUS
    lit_sphere.RADIUS = 0.8 * RADIUS
    try:
        return lit_sphere.lit_sphere(num_views=14, side=40)
    finally:
        lit_sphere.RADIUS = before


def trained_ball() -> InverseModel:
    """Return the model of a ball under one light, as a polish gets it."""
    torch.manual_seed(0)
    return sphere_model(lights=("sky",)).eval().requires_grad_(False)
