"""The scenes by name: what is in them, how many pictures, and in which light."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sample_environments import environment_image

from sample_scenes import bookcase, breakfast, metals, still_life, sunlit, tinware
from sample_scenes.lights import light_image
from sample_scenes.shapes import Surface

MATERIAL = (
    "number of the material where all of a pixel shows one of uniform albedo, 0 on background, "
    "255 where albedo varies or materials meet"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """One scene that the script renders."""

    name: str
    about: str
    objects: Callable[[], dict[str, Any]]
    """Builds the shapes in Mitsuba's terms."""
    surfaces: dict[str, Surface]
    """Materials whose number in material.png is their place among the uniform ones, counted from 1."""
    train_light: str
    unseen_lights: tuple[str, str]
    light: Callable[[str], np.ndarray] = light_image
    """Returns the environment [H, W, 3] of a light's name."""
    num_train: int = 60
    num_test: int = 20
    resolution: int = 128
    spp_train: int = 256
    spp_test: int = 1024
    truth_spp: int = 64
    """Rays per pixel behind the maps; a square."""
    training_maps: bool = True
    """Whether training views have albedo and normals beside their picture."""
    lowest: float = 0.10
    """Height of the lowest camera over its distance; the highest is at 0.92."""
    aim: float = -0.22
    """Height that the cameras look at, on the axis."""
    conventions: dict[str, str] = field(default_factory=lambda: {"material.png": MATERIAL})
    """What scene.json states beside the conventions of all scenes."""

    @property
    def lights(self) -> tuple[str, ...]:
        """Return the names of all lights, that of the photographs first."""
        return (self.train_light, *self.unseen_lights)

    @property
    def uniform_surfaces(self) -> dict[int, Surface]:
        """Return the materials of one base colour by their number in material.png."""
        uniform = [surface for surface in self.surfaces.values() if surface.is_uniform]
        return dict(enumerate(uniform, start=1))


SCENES = {
    scene.name: scene
    for scene in (
        Scene(
            name="breakfast",
            about="A brass jug, a glazed bowl with lemons, an apple, a pear and a folded cloth on a board.",
            objects=breakfast.objects,
            surfaces=breakfast.SURFACES,
            train_light="morning",
            unseen_lights=("studio", "sunset"),
            light=environment_image,
            num_train=40,
            num_test=6,
            resolution=256,
            spp_train=1024,
            spp_test=2048,
            training_maps=False,
        ),
        Scene(
            name="still_life",
            about="A glazed plate with a gold and a blue ball, a red box by a white vase and a painted ring.",
            objects=still_life.objects,
            surfaces=still_life.SURFACES,
            train_light="morning",
            unseen_lights=("studio", "sunset"),
            light=environment_image,
            num_train=40,
            num_test=6,
            resolution=96,
            spp_train=2048,
            spp_test=2048,
            truth_spp=256,
            conventions={},
        ),
        Scene(
            name="lamps",
            about="A bookcase with things in its niches, in a dim room with three small, bright lamps.",
            objects=bookcase.objects,
            surfaces=bookcase.SURFACES,
            train_light="spotlights",
            unseen_lights=("studio", "overcast"),
            spp_train=512,
            lowest=0.04,
            aim=-0.11,
        ),
        Scene(
            name="metals",
            about="A bronze column, a steel beaker, a copper kettle and small metal things on a stone slab.",
            objects=metals.objects,
            surfaces=metals.SURFACES,
            train_light="drawing_room",
            unseen_lights=("garage", "harbour"),
            spp_test=512,
        ),
        Scene(
            name="sunlit",
            about="Painted china, a printed box, a rubber boot, a ball, earthenware and wood on a board.",
            objects=sunlit.objects,
            surfaces=sunlit.SURFACES,
            train_light="garden",
            unseen_lights=("drawing_room", "harbour"),
            spp_test=512,
        ),
        Scene(
            name="tinware",
            about="A pot, a candlestick, a weight and a bowl of metal, a blue cup and two balls on wood.",
            objects=tinware.objects,
            surfaces=tinware.SURFACES,
            train_light="garage",
            unseen_lights=("drawing_room", "harbour"),
            num_test=8,
            spp_test=512,
        ),
    )
}
