"""Whole configurations by purpose; every preset shares every formula, only numbers differ."""

from collections.abc import Callable
from dataclasses import replace

from flashcache.caches.environment import EnvironmentConfig
from flashcache.caches.fast_cache import FastCacheConfig
from flashcache.caches.nerf_cache import NerfCacheConfig
from flashcache.config import (
    Config,
    EvaluationConfig,
    ExportConfig,
    Rates,
    StageOneConfig,
    StageTwoConfig,
)
from flashcache.data.ray_batches import PixelChoice
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.errors import ConfigError
from flashcache.fields.appearance import AppearanceConfig
from flashcache.fields.density import DensityConfig, NormalConfig
from flashcache.fields.materials import MaterialConfig
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig
from flashcache.physical.light_sampler import LightSamplerConfig
from flashcache.physical.model import ModelConfig
from flashcache.volume.proposal_sampling import SampleCounts


def _grid(
    finest: int, levels: int, features: int, log2_size: int, half_extent: float = 1.0
) -> HashGridConfig:
    return HashGridConfig(
        finest_resolution=finest,
        num_levels=levels,
        num_features=features,
        log2_table_size=log2_size,
        half_extent=half_extent,
    )


def fast() -> Config:
    """A first look at one's own scene: minutes on two CPU cores (docs/decisions/0001-cpu-presets.md)."""
    nerf = NerfCacheConfig(
        proposals=(
            DensityConfig(grid=_grid(128, 6, 1, 15), width=32, num_layers=1),
            DensityConfig(grid=_grid(256, 6, 1, 15), width=32, num_layers=1),
        ),
        density=DensityConfig(grid=_grid(256, 8, 2, 17), width=64, num_layers=1),
        normals=NormalConfig(own_grid=_grid(96, 6, 2, 15), width=64),
        appearance=AppearanceConfig(
            grid=_grid(256, 8, 2, 17),
            bottleneck=32,
            factor_width=32,
            num_degrees=4,
            width_bias=-3.0,
            view_frequencies=2,
            reflection_width=64,
            reflection_layers=2,
        ),
        primary_counts=SampleCounts(first=32, second=32, final=16),
        secondary_counts=SampleCounts(first=12, second=12, final=8),
        secondary_colours=1,
    )
    model = ModelConfig(
        nerf=nerf,
        fast=FastCacheConfig(
            distance_grid=_grid(64, 4, 4, 15),
            feature_grid=_grid(64, 4, 4, 15, half_extent=2.0),
            code_width=32,
            distance_width=64,
            distance_layers=3,
            decoder_widths=(32, 32),
        ),
        environment=EnvironmentConfig(width=64, num_layers=2, last_width=64),
        materials=MaterialConfig(grid=_grid(256, 8, 2, 17), width=64, metalness_bias=-2.0),
        light_sampler=LightSamplerConfig(grid=_grid(32, 2, 2, 15), width=32, num_lobes=16),
    )
    return Config(
        preset="fast",
        max_side=128,
        model=model,
        stage_one=StageOneConfig(
            num_steps=1500,
            num_rays=1024,
            rates=Rates(grid=1e-2, network=3e-3),
            final_rate=0.05,
            warmup_steps=80,
            carving_share=0.35,
            specular_from=0.4,
            random_background=True,
            mask_weight=0.0,
            distortion_weight=0.3,
            distortion_from=0.3,
            orientation_weight=0.01,
            normal_weight=0.5,
            normal_start=0.0,
            normal_ramp=(0.25, 0.45),
            normal_every=1,
            normal_rays=0.4,
            proposal_exponent=1.0,
        ),
        stage_two=StageTwoConfig(
            num_steps=900,
            num_rays=256,
            warmup_steps=150,
            estimator=EstimatorConfig(
                fast=DirectionCounts(cosine=7, sampler=5, specular=4),
                exact=DirectionCounts(cosine=2, sampler=1, specular=1),
                stratified=True,
            ),
            symmetric=True,
            material_rates=Rates(grid=5e-3, network=1.5e-3),
            cache_rates=Rates(grid=5e-4, network=1e-4),
            fast_rates=Rates(grid=1e-2, network=2e-3),
            environment_rate=3e-3,
            final_rate=0.1,
            decay_from=0.3,
            physical_weight=1.0,
            mask_weight=0.0,
            normal_weight=0.3,
            normal_every=2,
            normal_rays=0.25,
            random_background=True,
            smoothness_weight=0.003,
            grey_weight=0.015,
            proposal_exponent=1.0,
        ),
        evaluation=EvaluationConfig(num_views=4, num_repeats=1),
        checkpoint_steps=100_000,
        checkpoint_interval_s=30.0,
    )


def tiny() -> Config:
    """The whole method in less than a minute, for tests; its pictures are rough."""
    base = fast()
    nerf = replace(
        base.model.nerf,
        proposals=(
            DensityConfig(grid=_grid(64, 3, 1, 14), width=16, num_layers=1),
            DensityConfig(grid=_grid(96, 4, 1, 14), width=16, num_layers=1),
        ),
        density=DensityConfig(grid=_grid(96, 4, 2, 15), width=32, num_layers=1),
        normals=NormalConfig(own_grid=_grid(64, 3, 2, 14), width=32),
        appearance=replace(
            base.model.nerf.appearance,
            grid=_grid(96, 4, 2, 15),
            bottleneck=16,
            factor_width=16,
            reflection_width=32,
        ),
        primary_counts=SampleCounts(first=24, second=16, final=12),
    )
    model = replace(
        base.model,
        nerf=nerf,
        fast=replace(
            base.model.fast,
            distance_grid=_grid(32, 2, 2, 14),
            feature_grid=_grid(64, 3, 2, 15, half_extent=2.0),
            distance_width=32,
            distance_layers=2,
        ),
        environment=EnvironmentConfig(width=32, num_layers=2, last_width=32),
        materials=replace(base.model.materials, grid=_grid(96, 4, 2, 15), width=32),
        light_sampler=LightSamplerConfig(grid=_grid(32, 2, 2, 14), width=16, num_lobes=8),
    )
    return replace(
        base,
        preset="tiny",
        max_side=64,
        model=model,
        stage_one=replace(
            base.stage_one,
            num_steps=350,
            num_rays=512,
            warmup_steps=30,
            rates=Rates(grid=2e-2, network=1e-2),
        ),
        stage_two=replace(
            base.stage_two,
            num_steps=150,
            num_rays=128,
            warmup_steps=40,
            material_rates=Rates(grid=2e-2, network=5e-3),
            environment_rate=1e-2,
        ),
        evaluation=EvaluationConfig(num_views=2, num_repeats=1, num_directions=16),
        export=ExportConfig(gbuffer_samples=64, mesh_resolution=48, environment_height=32),
        checkpoint_steps=50,
    )


def long() -> Config:
    """A longer run without a GPU, meant for under an hour on two cores; not tuned or timed yet."""
    base = fast()
    return replace(
        base,
        preset="long",
        max_side=256,
        stage_one=replace(base.stage_one, num_steps=15_000, num_rays=1024),
        stage_two=replace(base.stage_two, num_steps=8_000, warmup_steps=500),
        evaluation=EvaluationConfig(num_views=8, num_repeats=2),
        checkpoint_steps=1000,
        checkpoint_interval_s=300.0,
    )


def standard() -> Config:
    """The paper's sizes with fewer rays and steps, meant for one GPU with 24 GB; not run on one yet."""
    paper = paper_tensoir()
    base = fast()
    appearance = replace(paper.model.nerf.appearance, bottleneck=64, reflection_width=64)
    nerf = replace(
        paper.model.nerf,
        density=replace(paper.model.nerf.density, softplus_beta=10.0),
        normals=NormalConfig(own_grid=_grid(128, 4, 2, 17)),
        appearance=appearance,
        secondary_colours=1,
    )
    return replace(
        paper,
        preset="standard",
        model=replace(paper.model, nerf=nerf),
        pixels=PixelChoice(),
        stage_one=replace(
            base.stage_one, num_steps=12_000, num_rays=4096, warmup_steps=500, distortion_weight=1e-3
        ),
        stage_two=replace(
            base.stage_two,
            num_steps=10_000,
            num_rays=1024,
            warmup_steps=500,
            estimator=EstimatorConfig(stratified=True),
        ),
        evaluation=EvaluationConfig(num_views=8, num_repeats=4),
    )


def paper_tensoir() -> Config:
    """The supplement's settings for TensoIR-synthetic, meant for one GPU with 80 GB; not run on one yet.

    Differs from the paper: the cache's specular branch is the network on an integrated directional encoding
    of the authors' public code, not the copy of the fast cache that supplement 2.2 describes.
    """

    def density(finest: int, features: int) -> DensityConfig:
        return DensityConfig(
            grid=HashGridConfig(finest_resolution=finest, num_features=features, log2_table_size=19),
            softplus_beta=None,
        )

    def fine(features: int = 4, finest: int = 2048, half_extent: float = 1.0) -> HashGridConfig:
        return HashGridConfig(
            finest_resolution=finest,
            num_features=features,
            log2_table_size=19,
            half_extent=half_extent,
        )

    nerf = NerfCacheConfig(
        proposals=(density(512, 1), density(1024, 1)),
        density=density(2048, 4),
        appearance=AppearanceConfig(grid=fine()),
    )
    return Config(
        preset="paper_tensoir",
        model=ModelConfig(
            nerf=nerf,
            fast=FastCacheConfig(
                distance_grid=fine(finest=256), feature_grid=fine(finest=256, half_extent=2.0)
            ),
            materials=MaterialConfig(grid=fine()),
            light_sampler=LightSamplerConfig(grid=fine()),
        ),
        pixels=PixelChoice(inside_share=0.0),
        stage_one=StageOneConfig(mask_weight=1.0, grid_decay=1.0),
        stage_two=StageTwoConfig(grid_decay=1.0),
        evaluation=EvaluationConfig(num_views=8, num_repeats=32),
        export=ExportConfig(gbuffer_samples=256, mesh_resolution=256, environment_height=128),
    )


def paper_openillumination() -> Config:
    """The supplement's settings for OpenIllumination, one GPU with 80 GB."""
    base = paper_tensoir()
    return replace(
        base,
        preset="paper_openillumination",
        max_side=1992,
        stage_one=replace(
            base.stage_one,
            normal_start=1.0,
            normal_ramp=(0.0, 0.0),
            proposal_exponent=0.8,
            grid_decay=0.1,
        ),
        stage_two=replace(
            base.stage_two,
            num_steps=100_000,
            physical_weight=1.0,
            proposal_exponent=0.8,
            smoothness_weight=0.001,
            smoothness_step=0.005,
            grid_decay=0.1,
        ),
    )


def paper_glossy() -> Config:
    """The supplement's settings for Glossy Synthetic, one GPU with 80 GB."""
    base = paper_tensoir()
    return replace(
        base,
        preset="paper_glossy",
        stage_one=replace(
            base.stage_one,
            mask_weight=10.0,
            distortion_weight=0.01,
            orientation_weight=0.01,
            normal_weight_gradient=0.0,
            grid_decay=0.1,
        ),
        stage_two=replace(
            base.stage_two,
            num_steps=20_000,
            mask_weight=10.0,
            distortion_weight=0.01,
            orientation_weight=0.01,
            normal_weight_gradient=0.0,
            smoothness_weight=0.001,
            smoothness_step=0.005,
            grid_decay=0.1,
        ),
    )


PRESETS: dict[str, Callable[[], Config]] = {
    preset.__name__: preset
    for preset in (tiny, fast, long, standard, paper_tensoir, paper_openillumination, paper_glossy)
}


def preset(name: str) -> Config:
    """Return the preset `name`; raises `ConfigError` listing the known ones."""
    if name not in PRESETS:
        raise ConfigError(f"unknown preset {name!r}; choose from {', '.join(PRESETS)}")
    return PRESETS[name]()
