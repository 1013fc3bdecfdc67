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
            directional_degrees=(1, 2, 4),
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
            num_steps=2200,
            num_rays=1024,
            rates=Rates(grid=1e-2, network=2e-3),
            final_rate=0.03,
            warmup_steps=100,
            carving_share=0.35,
            specular_from=0.45,
            random_background=True,
            mask_weight=0.0,
            distortion_weight=1e-3,
            distortion_from=0.5,
            orientation_weight=0.01,
            normal_weight=0.3,
            normal_start=0.0,
            normal_ramp=(0.35, 0.55),
            normal_every=2,
            normal_rays=0.25,
            proposal_exponent=1.0,
        ),
        stage_two=StageTwoConfig(
            num_steps=1200,
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
