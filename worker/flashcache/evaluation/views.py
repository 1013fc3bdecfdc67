"""Pictures of a trained model: its surface, and its appearance under training lights and new lights.

Pictures are numpy float32; radiance is linear Rec. 709, straight (not multiplied by opacity).
"""

import torch
from jaxtyping import Float32
from lambent_core.scene import Camera
from numpy import ndarray
from torch import Tensor

from flashcache.evaluation.gbuffer import GBuffer, camera_rays, render_gbuffer
from flashcache.evaluation.lighting import lit_radiance, sky_sampler
from flashcache.evaluation.monte_carlo import RenderRule, monte_carlo
from flashcache.evaluation.relighting import MapLight, relit_radiance
from flashcache.evaluation.supersampling import Picture, PictureSamples, finer, mean_gbuffer
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints

__all__ = [
    "GBuffer",
    "Picture",
    "PictureSamples",
    "RenderRule",
    "camera_rays",
    "render_gbuffer",
    "render_physical",
    "render_relit",
    "render_surface",
]
RULE, SAMPLES = RenderRule(), PictureSamples()


def render_surface(model: InverseModel, camera: Camera, *, light: int = 0, antialias: int = 1) -> GBuffer:
    """Return the surface as `camera` sees it, a mean over `antialias` x `antialias` rays per pixel."""
    return mean_gbuffer(render_gbuffer(model, finer(camera, antialias), light=light), camera, antialias)


@torch.no_grad()
def render_physical(
    model: InverseModel,
    camera: Camera,
    samples: PictureSamples = SAMPLES,
    *,
    light: int = 0,
    seed: int = 0,
    rule: RenderRule = RULE,
) -> Picture:
    """Return the physically based picture under a training light.

    Every repeat spreads the directions of a pixel, those of the fast estimate, over its points, with four
    more per point for the correction (supplement 2.5). A rule without control variate leaves those four, to
    the NeRF cache alone. Unlike in training, both lobes share all directions (`relight`), and half of these
    are drawn from the environment.
    """
    sky = sky_sampler(model, light) if rule.sampler == "vmf" else None

    def shade(points: ShadingPoints, generator: torch.Generator) -> Tensor:
        count = samples.directions_per_point
        return lit_radiance(model, points, num_directions=count, rule=rule, generator=generator, sky=sky)

    return monte_carlo(
        model, camera, shade, samples, light=light, seed=seed, purpose="physical", points=rule.points
    )


@torch.no_grad()
def render_relit(
    model: InverseModel,
    camera: Camera,
    environment_map: Float32[ndarray, "rows columns 3"],
    samples: PictureSamples = SAMPLES,
    *,
    albedo_ratio: tuple[float, float, float] = (1.0, 1.0, 1.0),
    indirect: bool = True,
    seed: int = 0,
    rule: RenderRule = RULE,
) -> Picture:
    """Return the picture under a new environment (linear, convention of `geometry.directions`).

    Direct light with learned shadows as in the paper's relighting, and with `indirect` one bounce: what
    secondary rays hit is shaded under the new environment with its own materials. `albedo_ratio` multiplies
    the albedo.
    """
    device = next(model.parameters()).device
    light_map = MapLight.from_image(environment_map, device)
    ratio = torch.tensor(albedo_ratio, dtype=torch.float32, device=device)

    def shade(points: ShadingPoints, generator: torch.Generator) -> Tensor:
        cache = model.fast_source() if rule.shadow_cache == "fast" else model.nerf_source(generator)
        return relit_radiance(
            model,
            points,
            light_map,
            ratio,
            cache=cache,
            num_directions=samples.directions_per_point,
            indirect=indirect,
            generator=generator,
        )

    return monte_carlo(model, camera, shade, samples, light=0, seed=seed, purpose="relit", points=rule.points)
