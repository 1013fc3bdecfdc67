"""Whole configurations by purpose; every preset shares every formula, only numbers differ."""

from collections.abc import Callable
from dataclasses import replace

from flashcache.caches.environment import EnvironmentConfig
from flashcache.caches.fast_cache import FastCacheConfig
from flashcache.caches.nerf_cache import NerfCacheConfig
from flashcache.config import (
    Config,
    DistilConfig,
    EvaluationConfig,
    ExportConfig,
    Rates,
    StageOneConfig,
    StageTwoConfig,
)
from flashcache.data.ray_batches import PixelChoice
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.errors import ConfigError
from flashcache.fields.appearance import AppearanceConfig
from flashcache.fields.density import DensityConfig, NormalConfig
from flashcache.fields.materials import MaterialConfig
from flashcache.losses.clusters import ClusterConfig
from flashcache.losses.metalness import MetalnessPriorConfig
from flashcache.losses.shape import ShapePriorConfig
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig
from flashcache.physical.light_sampler import LightSamplerConfig
from flashcache.physical.model import ModelConfig
from flashcache.presets_paper import (
    of_scene,
    paper_glossy,
    paper_model,
    paper_openillumination,
    paper_tensoir,
)
from flashcache.volume.proposal_sampling import SampleCounts

BRIGHT_VARIATION = (0.03, 0.12)
"""Second test of metals, for caches that learned for thousands of steps and vary more (decision 0015)."""


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


def _gloss_grid(grid: HashGridConfig, finest: int = 32) -> HashGridConfig:
    """Return a coarse grid for GGX width and metalness beside `grid`, that of albedo (decision 0025)."""
    return replace(
        grid,
        base_resolution=8,
        finest_resolution=finest,
        num_levels=3 if finest > 16 else 2,
        log2_table_size=15,
    )


def _shape_prior(emptiness_weight: float = 0.0) -> ShapePriorConfig:
    """Return the priors on shape for short trainings (decisions 0014 and 0021)."""
    return ShapePriorConfig(recession_weight=0.15, flatness_weight=0.03, emptiness_weight=emptiness_weight)


def _stage_one() -> StageOneConfig:
    """Return the losses of stage one for short trainings, with rates for batches of 1024 rays."""
    return StageOneConfig(
        num_steps=1200,
        num_rays=1024,
        rates=Rates(grid=1e-2, network=3e-3),
        final_rate=0.05,
        warmup_steps=80,
        carving_share=0.2,
        specular_from=0.08,
        random_background=True,
        mask_weight=0.3,
        distortion_weight=0.3,
        distortion_from=0.3,
        orientation_weight=0.01,
        normal_weight=0.25,
        normal_start=0.0,
        normal_ramp=(0.18, 0.25),
        normal_every=1,
        normal_rays=0.5,
        shape_prior=_shape_prior(),
        proposal_exponent=1.0,
    )


def fast() -> Config:
    """Return the preset for a first result on your own scene: minutes on two CPU cores (decision 0001)."""
    return Config(
        preset="fast",
        polish="on",
        max_side=128,
        crop="object",
        model=_fast_model(),
        pixels=PixelChoice(clipped="at_least"),
        stage_one=replace(
            _stage_one(),
            num_steps=1800,
            num_rays=512,
            rates=Rates(grid=1.2e-2, network=3e-3),
            warmup_steps=120,
            normal_rays=1.0,
            shape_prior=_shape_prior(emptiness_weight=0.01),
        ),
        stage_two=_fast_stage_two(),
        evaluation=EvaluationConfig(num_views=4, num_repeats=1, antialias=2, uncertainty_points=300),
        export=ExportConfig(judge_samples=16),
        checkpoint_steps=100_000,
        checkpoint_interval_s=30.0,
    )


def _fast_model() -> ModelConfig:
    """Return networks and grids that two CPU cores train in minutes."""
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
            num_degrees=5,
            width_bias=-3.0,
            view_frequencies=2,
            reflection_width=64,
            reflection_layers=2,
        ),
        primary_counts=SampleCounts(first=16, second=16, final=12),
        secondary_counts=SampleCounts(first=12, second=12, final=8),
        secondary_colours=1,
        secondary_sure_opacity=0.02,
        least_weight=1e-3,
    )
    return ModelConfig(
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
        materials=MaterialConfig(
            grid=_grid(256, 8, 2, 17),
            gloss_grid=_gloss_grid(_grid(256, 8, 2, 17)),
            width=64,
            metalness_bias=-2.0,
            alpha_gradient=1.0,
        ),
        light_sampler=LightSamplerConfig(grid=_grid(32, 2, 2, 15), width=32, num_lobes=16),
        occupancy=OccupancyConfig(cells=64),
    )


def _fast_stage_two() -> StageTwoConfig:
    """Return stage two with few rays, and with the priors that make up for them."""
    return StageTwoConfig(
        num_steps=700,
        num_rays=256,
        warmup_steps=120,
        estimator=EstimatorConfig(
            fast=DirectionCounts(cosine=5, sampler=3, specular=8),
            exact=DirectionCounts(cosine=2, sampler=1, specular=1),
            stratified=True,
        ),
        symmetric=True,
        material_rates=Rates(grid=5e-3, network=1.5e-3),
        gloss_rates=Rates(grid=2e-2, network=2e-3),
        gloss_from=0.35,
        cache_rates=Rates(grid=5e-4, network=1e-4),
        fast_rates=Rates(grid=1e-2, network=2e-3),
        environment_rate=3e-3,
        final_rate=0.1,
        decay_from=0.3,
        physical_weight=1.0,
        mask_weight=0.0,
        normal_weight=0.15,
        normal_every=2,
        normal_rays=0.25,
        random_background=True,
        smoothness_weight=0.0,
        clusters=ClusterConfig(weight=0.004, gloss=0.0, gloss_weight=0.04, gloss_distance=0.1),
        grey_weight=0.015,
        tint_weight=0.1,
        metalness_prior=MetalnessPriorConfig(
            warmup_weight=1.0,
            weight=0.3,
            num_directions=8,
            range=(0.03, 1.0),
            perceptual_roughness=(0.52, 0.25),
        ),
        proposal_exponent=1.0,
        distil=DistilConfig(num_steps=300),
    )


def quick() -> Config:
    """Return `fast` with as few steps as a first look needs: about a minute on two CPU cores."""
    base = fast()
    nerf = replace(base.model.nerf, primary_counts=SampleCounts(first=16, second=16, final=8))
    return replace(
        base,
        preset="quick",
        polish="off",
        model=replace(base.model, nerf=nerf),
        stage_one=replace(base.stage_one, num_steps=1200, warmup_steps=80),
        stage_two=replace(
            base.stage_two,
            num_steps=240,
            warmup_steps=60,
            gloss_rates=Rates(grid=4e-2, network=4e-3),
            distil=DistilConfig(num_steps=80),
        ),
        evaluation=replace(base.evaluation, num_views=2, num_directions=32, uncertainty_points=100),
        export=replace(base.export, transport_size=256, occlusion_points=5000, judge_samples=0),
    )


def tiny() -> Config:
    """Return the complete method in less than a minute, for tests; its pictures are rough."""
    base = fast()
    return replace(
        base,
        preset="tiny",
        polish="off",
        max_side=64,
        model=_tiny_model(base.model),
        stage_one=replace(
            base.stage_one,
            num_steps=350,
            num_rays=512,
            warmup_steps=30,
            rates=Rates(grid=2e-2, network=1e-2),
            shape_prior=_shape_prior(emptiness_weight=0.1),
        ),
        stage_two=replace(
            base.stage_two,
            num_steps=150,
            num_rays=128,
            warmup_steps=40,
            smoothness_weight=0.003,
            clusters=ClusterConfig(gloss_weight=0.04, gloss_distance=0.1),
            material_rates=Rates(grid=2e-2, network=5e-3),
            gloss_rates=Rates(grid=4e-2, network=4e-3),
            environment_rate=1e-2,
            distil=DistilConfig(num_steps=20, num_points=256),
        ),
        evaluation=EvaluationConfig(num_views=2, num_repeats=1, num_directions=16, uncertainty_points=150),
        export=ExportConfig(
            gbuffer_samples=64,
            mesh_resolution=48,
            max_faces=2000,
            atlas_size=256,
            transport_size=128,
            occlusion_points=2000,
            occlusion_rays=16,
            judge_samples=8,
            environment_height=32,
        ),
        checkpoint_steps=50,
    )


def _tiny_model(base: ModelConfig) -> ModelConfig:
    """Return the networks and grids of `base`, made as small as tests need them."""
    nerf = replace(
        base.nerf,
        proposals=(
            DensityConfig(grid=_grid(64, 3, 1, 14), width=16, num_layers=1),
            DensityConfig(grid=_grid(96, 4, 1, 14), width=16, num_layers=1),
        ),
        density=DensityConfig(grid=_grid(96, 4, 2, 15), width=32, num_layers=1),
        normals=NormalConfig(own_grid=_grid(64, 3, 2, 14), width=32),
        appearance=replace(
            base.nerf.appearance,
            grid=_grid(96, 4, 2, 15),
            bottleneck=16,
            factor_width=16,
            reflection_width=32,
        ),
        primary_counts=SampleCounts(first=24, second=16, final=12),
    )
    return replace(
        base,
        nerf=nerf,
        fast=replace(
            base.fast,
            distance_grid=_grid(32, 2, 2, 14),
            feature_grid=_grid(64, 3, 2, 15, half_extent=2.0),
            distance_width=32,
            distance_layers=2,
        ),
        environment=EnvironmentConfig(width=32, num_layers=2, last_width=32),
        materials=replace(
            base.materials,
            grid=_grid(96, 4, 2, 15),
            gloss_grid=_gloss_grid(_grid(96, 4, 2, 15), finest=16),
            width=32,
        ),
        light_sampler=LightSamplerConfig(grid=_grid(32, 2, 2, 14), width=16, num_lobes=8),
        occupancy=OccupancyConfig(cells=32),
    )


def long() -> Config:
    """Return a longer run without a GPU; figures: docs/benchmarks/long-curve.md."""
    base = fast()
    counts = SampleCounts(first=32, second=32, final=16)
    nerf = replace(base.model.nerf, primary_counts=counts, least_weight=0.0)
    return replace(
        base,
        preset="long",
        max_side=256,
        model=replace(base.model, nerf=nerf, occupancy=OccupancyConfig()),
        stage_one=replace(_stage_one(), num_steps=8_000),
        stage_two=replace(
            base.stage_two,
            num_steps=4_000,
            warmup_steps=300,
            gloss_from=0.15,
            metalness_prior=replace(
                base.stage_two.metalness_prior, num_directions=16, bright_variation=BRIGHT_VARIATION
            ),
            distil=DistilConfig(num_steps=1500),
        ),
        evaluation=EvaluationConfig(num_views=8, num_repeats=2, antialias=2),
        checkpoint_steps=1000,
        checkpoint_interval_s=300.0,
    )


def standard() -> Config:
    """Return the paper's sizes with fewer rays and steps, for one GPU with 24 GB; not run to its end yet."""
    paper = paper_tensoir()
    sizes = paper_model(output_scale=1.0)
    base = fast()
    appearance = replace(sizes.nerf.appearance, architecture="ide", bottleneck=64, reflection_width=64)
    nerf = replace(
        sizes.nerf,
        density=replace(sizes.nerf.density, softplus_beta=10.0),
        normals=NormalConfig(own_grid=_grid(128, 4, 2, 17)),
        appearance=appearance,
        secondary_colours=1,
        normal_floor=base.model.nerf.normal_floor,
        exponent=base.model.nerf.exponent,
    )
    return replace(
        paper,
        preset="standard",
        polish="off",
        crop=base.crop,
        space=base.space,
        model=replace(
            sizes,
            nerf=nerf,
            materials=replace(
                sizes.materials, gloss_grid=_gloss_grid(sizes.materials.grid), alpha_gradient=1.0
            ),
        ),
        pixels=base.pixels,
        stage_one=replace(
            _stage_one(), num_steps=12_000, num_rays=4096, warmup_steps=500, distortion_weight=1e-3
        ),
        stage_two=replace(
            base.stage_two,
            num_steps=10_000,
            num_rays=1024,
            warmup_steps=500,
            gloss_from=0.15,
            estimator=EstimatorConfig(stratified=True),
            metalness_prior=replace(
                base.stage_two.metalness_prior, num_directions=16, bright_variation=BRIGHT_VARIATION
            ),
            distil=DistilConfig(num_steps=1000, num_points=2048),
        ),
        evaluation=EvaluationConfig(num_views=8, num_repeats=4, antialias=2),
    )


PRESETS: dict[str, Callable[[], Config]] = {
    preset.__name__: preset
    for preset in (tiny, quick, fast, long, standard, paper_tensoir, paper_openillumination, paper_glossy)
}


def preset(name: str) -> Config:
    """Return the preset `name`, or with `PRESET:SCENE` the paper's settings for a published scene.

    Raises `ConfigError` listing the known ones.
    """
    name, colon, scene = name.partition(":")
    if name not in PRESETS:
        raise ConfigError(f"unknown preset {name!r}; choose from {', '.join(PRESETS)}")
    config = PRESETS[name]()
    return of_scene(config, scene) if colon else config
