"""The spatial extent of a scene: the capture's own, or that of a preset for a published dataset."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from lambent_core.scene import Scene

from flashcache.caches.environment import EnvironmentConfig
from flashcache.encoding.turns import IDENTITY
from flashcache.errors import ConfigError
from flashcache.physical.model import Domain

_DEGREES = re.compile(r"_(\d{1,3})$")


@dataclass(frozen=True, kw_only=True, slots=True)
class SpaceConfig:
    """Distances in scene units that replace those of the capture; 0 keeps the capture's."""

    contraction_radius: float = 0.0
    """Distance from the origin at which space begins to be contracted."""
    primary: tuple[float, float] = (0.0, 0.0)
    """Near and far distance along camera rays."""
    secondary: tuple[float, float] = (0.0, 0.0)
    """Near and far distance along rays that leave a surface."""
    origin_offset: float = 0.0
    """Distance of secondary rays' origins from the surface; 0 is a fifth of their near distance."""
    fast_radius: float = 0.0
    """Distance from the origin within which rays teach the fast cache; 0 is the contraction radius."""

    def __post_init__(self) -> None:
        for name in ("primary", "secondary"):
            near, far = getattr(self, name)
            if (near, far) != (0.0, 0.0) and not 0.0 <= near < far:
                raise ConfigError(f"space.{name} needs 0 <= near < far, got {near} and {far}")
        for name in ("contraction_radius", "origin_offset", "fast_radius"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"space.{name} must not be negative, got {getattr(self, name)}")


def placed(scene: Scene, space: SpaceConfig) -> Scene:
    """Return `scene` with the distances that `space` states."""
    return replace(
        scene,
        contraction_radius=space.contraction_radius or scene.contraction_radius,
        primary=space.primary if space.primary[1] else scene.primary,
        secondary=space.secondary if space.secondary[1] else scene.secondary,
    )


def domain_of(
    scene: Scene,
    space: SpaceConfig,
    environment: EnvironmentConfig,
    known_lights: Sequence[str] = (),
) -> Domain:
    """Return the domain of a model for a scene, with the distances of `space`.

    Raises `ConfigError` for rotated lights without an angle, and for several lights that turn.
    """
    scene = placed(scene, space)
    turned = scene.turned
    if turned and (len(scene.lights) > 1 or environment.lights != "separate"):
        raise ConfigError(
            f"the light turns with the camera, and there are {len(scene.lights)} lights "
            f"({', '.join(scene.lights)}); train on one of them, without --rotated"
        )
    turns = [tuple(np.asarray(view.light_turn).ravel().tolist()) for view in turned]
    return Domain(
        bounds_min=scene.bounds_min,
        bounds_max=scene.bounds_max,
        primary=scene.primary,
        secondary=scene.secondary,
        contraction_radius=scene.contraction_radius,
        lights=scene.lights,
        origin_offset=space.origin_offset,
        fast_radius=space.fast_radius,
        rotations_deg=rotations_of(scene.lights, environment),
        known_lights=tuple(known_lights),
        turns=(IDENTITY, *turns) if turns else (),
    )


def rotations_of(lights: Sequence[str], config: EnvironmentConfig) -> tuple[float, ...]:
    """Return the angle in degrees by which each light is the one environment turned about +z.

    Empty where every light has an environment of its own. Angles come from the configuration, or from the
    lights' names as in `sunset_120`. Raises `ConfigError` where there is neither.
    """
    if config.lights == "separate":
        return ()
    if config.rotations_deg:
        if len(config.rotations_deg) != len(lights):
            raise ConfigError(
                f"model.environment.rotations_deg has {len(config.rotations_deg)} angles for "
                f"{len(lights)} lights ({', '.join(lights)}); give one per light, in their order"
            )
        return config.rotations_deg
    matches = {light: _DEGREES.search(light) for light in lights}
    missing = [light for light, match in matches.items() if match is None]
    if missing:
        raise ConfigError(
            f"rotated lights: {', '.join(missing)} has no angle in its name (as sunset_120 has); set "
            "model.environment.rotations_deg, one angle per light"
        )
    return tuple(float(match[1]) for match in matches.values() if match is not None)
