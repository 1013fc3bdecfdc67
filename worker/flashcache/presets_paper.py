"""The paper's settings by dataset, and by published scene where the authors' code distinguishes scenes.

Where each number comes from: tests/golden/paper_presets.txt. Meant for one GPU with 80 GB; time and
memory per step: docs/benchmarks/paper-step.md.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from flashcache.caches.fast_cache import FastCacheConfig
from flashcache.caches.nerf_cache import NerfCacheConfig
from flashcache.config import Config, EvaluationConfig, ExportConfig, StageOneConfig, StageTwoConfig
from flashcache.data.ray_batches import PixelChoice
from flashcache.data.space import SpaceConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.errors import ConfigError
from flashcache.fields.appearance import AppearanceConfig
from flashcache.fields.density import DensityConfig
from flashcache.fields.materials import MaterialConfig
from flashcache.physical.estimator import EstimatorConfig
from flashcache.physical.light_sampler import LightSamplerConfig
from flashcache.physical.model import ModelConfig


def paper_model(half_extent: float = 1.0, output_scale: float = 10.0) -> ModelConfig:
    """Return the paper's sizes; `half_extent` is that of all grids but the fast cache's feature grid."""

    def grid(finest: int = 2048, features: int = 4, half_extent: float = half_extent) -> HashGridConfig:
        return HashGridConfig(
            finest_resolution=finest,
            num_features=features,
            log2_table_size=19,
            half_extent=half_extent,
            output_scale=output_scale,
        )

    def density(finest: int, features: int) -> DensityConfig:
        return DensityConfig(grid=grid(finest, features), softplus_beta=None)

    along_rays = FastCacheConfig(distance_grid=grid(256), feature_grid=grid(256, half_extent=2.0))
    nerf = NerfCacheConfig(
        proposals=(density(512, 1), density(1024, 1)),
        density=density(2048, 4),
        appearance=AppearanceConfig(architecture="fast_like", grid=grid()),
        reflected=along_rays,
        normal_floor=3.5e-4,
        exponent=0.4,
    )
    return ModelConfig(
        nerf=nerf,
        fast=along_rays,
        materials=MaterialConfig(grid=grid()),
        light_sampler=LightSamplerConfig(grid=grid()),
    )


def paper_tensoir() -> Config:
    """Return the supplement's settings for TensoIR-synthetic."""
    return Config(
        preset="paper_tensoir",
        space=SpaceConfig(contraction_radius=2.0, primary=(2.0, 6.0), secondary=(0.05, 2.0), fast_radius=2.0),
        model=paper_model(),
        pixels=PixelChoice(inside_share=0.0),
        stage_one=StageOneConfig(decay="linear", mask_weight=1.0, orientation_derived=0.0, grid_decay=1.0),
        stage_two=StageTwoConfig(
            estimator=EstimatorConfig(through_cache=1e-4),
            secondary_jitter=True,
            orientation_derived=0.0,
            pseudo_albedo="radiance",
            distance_weight=0.0,
            fast_by_half=True,
            grid_decay=1.0,
        ),
        evaluation=EvaluationConfig(num_views=8, num_repeats=32),
        export=ExportConfig(
            gbuffer_samples=256,
            transport_size=1024,
            environment_height=128,
        ),
    )


def paper_openillumination() -> Config:
    """Return the supplement's settings for OpenIllumination."""
    base = _with_exponent(paper_tensoir(), 0.8)
    return replace(
        base,
        preset="paper_openillumination",
        max_side=1992,
        space=SpaceConfig(
            contraction_radius=1.0,
            primary=(0.25, 2.0),
            secondary=(0.02, 0.5),
            origin_offset=0.01,
            fast_radius=0.5,
        ),
        stage_one=replace(base.stage_one, normal_start=1.0, normal_ramp=(0.0, 0.0), grid_decay=0.1),
        stage_two=replace(
            base.stage_two,
            num_steps=100_000,
            physical_weight=1.0,
            consistency_weight=0.01,
            smoothness_weight=0.001,
            smoothness_step=0.005,
            grid_decay=0.1,
        ),
    )


def paper_glossy() -> Config:
    """Return the supplement's settings for Glossy Synthetic."""
    base = paper_tensoir()
    shape: dict[str, Any] = {
        "mask_weight": 10.0,
        "distortion_weight": 0.01,
        "orientation_weight": 0.01,
        "normal_weight": 0.5,
        "normal_weight_gradient": 0.0,
        "grid_decay": 0.1,
    }
    return replace(
        base,
        preset="paper_glossy",
        space=SpaceConfig(contraction_radius=2.0, primary=(1.0, 4.0), secondary=(0.05, 1.0), fast_radius=1.0),
        model=paper_model(half_extent=2.0),
        stage_one=replace(base.stage_one, **shape),
        stage_two=replace(
            base.stage_two, num_steps=20_000, smoothness_weight=0.001, smoothness_step=0.005, **shape
        ),
    )


def _with_exponent(config: Config, exponent: float) -> Config:
    """Return `config` with another end of the annealing of proposal weights, everywhere it is used."""
    nerf = replace(config.model.nerf, exponent=exponent)
    return replace(
        config,
        model=replace(config.model, nerf=nerf),
        stage_one=replace(config.stage_one, proposal_exponent=exponent),
        stage_two=replace(config.stage_two, proposal_exponent=exponent),
    )


def _with_shape(config: Config, **settings: Any) -> Config:
    """Return `config` with loss weights on shape changed in both stages."""
    return replace(
        config,
        stage_one=replace(config.stage_one, **settings),
        stage_two=replace(config.stage_two, **settings),
    )


def _compact(config: Config) -> Config:
    return _with_shape(config, distortion_weight=0.01, orientation_weight=0.01)


def _as_it_is(config: Config) -> Config:
    return config


def _softer_normals(config: Config) -> Config:
    return _with_shape(config, normal_weight=0.125)


SCENES: Mapping[str, Mapping[str, Callable[[Config], Config]]] = {
    "paper_tensoir": {
        "armadillo": _as_it_is,
        "ficus": lambda config: _with_exponent(config, 1.0),
        "hotdog": _compact,
        "lego": _compact,
    },
    "paper_glossy": {
        **dict.fromkeys(("bell", "luyu", "potion"), _as_it_is),
        **dict.fromkeys(("angel", "cat", "horse", "tbell", "teapot"), _softer_normals),
    },
}
"""Published scenes with settings of their own in the authors' configuration, by preset."""


def of_scene(config: Config, scene: str) -> Config:
    """Return a paper preset with the settings of a published scene; `ConfigError` for an unknown one."""
    known = SCENES.get(config.preset, {})
    if scene not in known:
        raise ConfigError(
            f"preset {config.preset!r} has no settings for scene {scene!r}; it has some for "
            f"{', '.join(known) or 'none'}"
        )
    return known[scene](config)
