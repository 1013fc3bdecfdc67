"""The configuration of a run, as one frozen tree of dataclasses."""

import dataclasses
import json
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from flashcache.data.ray_batches import PixelChoice
from flashcache.data.space import SpaceConfig
from flashcache.errors import ConfigError
from flashcache.losses.clusters import ClusterConfig
from flashcache.losses.metalness import MetalnessPriorConfig
from flashcache.losses.shape import ShapePriorConfig
from flashcache.losses.smoothness import SmoothnessGuide
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig
from flashcache.physical.model import ModelConfig

T = typing.TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class Rates:
    """Learning rates of one part of the model."""

    grid: float
    """Peak rate of feature grids."""
    network: float
    """Peak rate of the networks behind them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StageOneConfig:
    """Training of the NeRF cache on the photographs (supplement 2.4)."""

    num_steps: int = 100_000
    num_rays: int = 16_384
    rates: Rates = field(default_factory=lambda: Rates(grid=0.01, network=0.01))
    final_rate: float = 0.1
    """Rate at the end as a share of the peak."""
    decay: typing.Literal["log_linear", "linear"] = "log_linear"
    """How rates fall: log-linearly from the first step, or linearly after the warm-up as in the paper."""
    warmup_steps: int = 10_000
    carving_share: float = 0.0
    """Share of the steps in which shape comes first; 0 as in the paper (decision 0002)."""
    specular_from: float = 0.0
    """Share of the steps after which radiance may depend on direction."""
    random_background: bool = False
    """Composite over random colours instead of white."""
    mask_weight: float = 1.0
    interlevel_weight: float = 0.01
    interlevel_blur: tuple[float, float] = (0.03, 0.003)
    """Half widths in normalised distance, per proposal."""
    distortion_weight: float = 0.0
    distortion_from: float = 0.0
    orientation_weight: float = 0.0
    orientation_derived: float = 2.0
    """Weight of derived normals in the orientation loss, where predicted ones have 1; the paper has 0."""
    normal_weight: float = 1.0
    """Final weight of the normal loss, C in supplement Eq. 6."""
    normal_start: float = 1e-4
    """Weight of the normal loss before its ramp."""
    normal_ramp: tuple[float, float] = (0.2, 0.4)
    """Shares of the steps between which the weight rises linearly."""
    normal_every: int = 1
    """Steps between two normal losses."""
    normal_rays: float = 1.0
    """Share of the rays that take part in the normal loss."""
    normal_weight_gradient: float = 0.1
    """Share of the gradient that the render weights get from the normal loss."""
    shape_prior: ShapePriorConfig = field(default_factory=ShapePriorConfig)
    grid_decay: float = 0.0
    """Weight of half the mean squared value of each level of density and proposal grids (decision 0019)."""
    proposal_exponent: float = 0.4
    """Largest exponent of the proposal weights (annealing ends there)."""

    def __post_init__(self) -> None:
        for name in ("num_steps", "num_rays", "normal_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"stage_one.{name} must be at least 1, got {getattr(self, name)}")
        for name in ("carving_share", "specular_from", "normal_rays"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"stage_one.{name} must lie in 0..1, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True, slots=True)
class DistilConfig:
    """The last steps of stage two, in which the fast cache alone learns (decision 0017)."""

    num_steps: int = 0
    """Steps after those of the stage; the paper has none."""
    num_points: int = 640
    """Camera rays per step; secondary rays start where they meet the surface."""
    taught: DirectionCounts = field(default_factory=lambda: DirectionCounts(cosine=6, sampler=0, specular=2))
    """Secondary rays per point, around the normal and around the mirror lobe."""
    opacity_weight: float = 1.0
    """Weight of opacity relative to radiance; joint training uses the paper's."""
    final_rate: float = 0.1
    """Share of the peak rates at the last step."""
    decay_from: float = 0.3
    """Share of the steps after which the rates begin to fall."""

    def __post_init__(self) -> None:
        if self.num_points < 1:
            raise ConfigError(f"stage_two.distil.num_points must be at least 1, got {self.num_points}")
        if self.taught.cosine + self.taught.sampler < 1 or self.taught.specular < 1:
            raise ConfigError(
                "stage_two.distil.taught needs at least one diffuse and one specular direction, "
                f"got {self.taught}"
            )
        if self.num_steps < 0:
            raise ConfigError(f"stage_two.distil.num_steps must not be negative, got {self.num_steps}")


@dataclass(frozen=True, kw_only=True, slots=True)
class StageTwoConfig:
    """Joint training of cache, materials, light, fast cache and sampler (supplement 2.4 to 2.10)."""

    num_steps: int = 40_000
    num_rays: int = 1024
    warmup_steps: int = 0
    """First steps in which only the fast cache and the sampler train (decision 0005)."""
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    """Secondary rays; their near and far distance come from the scene."""
    points: typing.Literal["categorical", "depth"] = "categorical"
    points_per_ray: int = 1
    """K of paper Eq. 11."""
    secondary_jitter: bool = False
    """Move the intervals along exact secondary rays at random, as the paper does; less biased and noisier."""
    symmetric: bool = False
    """Let gradients flow into both passes instead of only the first; their mean is the same."""
    material_rates: Rates = field(default_factory=lambda: Rates(grid=3.125e-5, network=3.125e-5))
    gloss_rates: Rates = field(default_factory=lambda: Rates(grid=3.125e-5, network=3.125e-5))
    """Of GGX width and metalness, where they have a grid of their own (`model.materials.gloss_grid`)."""
    gloss_from: float = 0.0
    """Share of the steps before which photographs change neither GGX width nor metalness of what is taken for
    a dielectric, and materials are not drawn together (decision 0025)."""
    cache_rates: Rates = field(default_factory=lambda: Rates(grid=3.125e-5, network=3.125e-5))
    fast_rates: Rates = field(default_factory=lambda: Rates(grid=1.5625e-4, network=1.5625e-4))
    environment_rate: float = 3.125e-5
    final_rate: float = 1.0
    decay_from: float = 0.0
    """Share of the steps after which the rates begin to fall."""
    physical_weight: float = 0.1
    """Weight of the loss on the physical pictures; the paper does not state it (decision 0019)."""
    mask_weight: float = 1.0
    distortion_weight: float = 0.0
    orientation_weight: float = 0.0
    orientation_derived: float = 2.0
    normal_weight: float = 1.0
    normal_every: int = 1
    normal_rays: float = 1.0
    normal_weight_gradient: float = 0.1
    random_background: bool = False
    consistency_weight: float = 0.1
    """Weight of the consistency losses; the paper does not state it (decision 0019)."""
    smoothness_weight: float = 0.05
    smoothness_step: float = 0.01
    """Standard deviation of the step between compared points, scene units."""
    smoothness_guide: SmoothnessGuide = "decreasing"
    pseudo_albedo: typing.Literal["diffuse", "radiance"] = "diffuse"
    """The cache's radiance from which the pseudo-albedo is computed; the paper uses all of it."""
    clusters: ClusterConfig = field(default_factory=ClusterConfig)
    grey_weight: float = 0.0
    """Weight of the environment's mean deviation from grey (decision 0006)."""
    tint_weight: float = 0.0
    """Weight of the deviation of the environment's mean from grey (decision 0030)."""
    metalness_prior: MetalnessPriorConfig = field(default_factory=MetalnessPriorConfig)
    distance_weight: float = 0.1
    """Weight of the fast cache's distance relative to its radiance (decision 0004); 0 in the paper's code."""
    fast_by_half: bool = False
    """Give the diffuse and the specular half equal weight in the fast cache's loss, as in the paper."""
    grid_decay: float = 0.0
    """The same for the levels of density, material and sampler grids."""
    proposal_exponent: float = 0.4
    distil: DistilConfig = field(default_factory=DistilConfig)

    def __post_init__(self) -> None:
        for name in ("num_steps", "num_rays", "points_per_ray", "normal_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"stage_two.{name} must be at least 1, got {getattr(self, name)}")
        if not 0.0 <= self.normal_rays <= 1.0:
            raise ConfigError(f"stage_two.normal_rays must lie in 0..1, got {self.normal_rays}")


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluationConfig:
    """The evaluation inside a job; `lambent evaluate` runs the full one."""

    num_views: int = 4
    num_repeats: int = 1
    num_directions: int = 64
    """Secondary rays per pixel and repeat."""
    antialias: int = 1
    """Camera rays along each side of a pixel; 1 is a ray through its centre, as in the paper."""
    uncertainty_points: int = 1000
    """Surface points at which the uncertainty of materials is measured; 0 skips it."""

    def __post_init__(self) -> None:
        if self.antialias < 1:
            raise ConfigError(f"evaluation.antialias must be at least 1, got {self.antialias}")


SIZE_STEP = 16
"""Texels: levels of detail have a half and a quarter of a size, and compressed ones blocks of 4 x 4."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportConfig:
    """Settings of the bundle export."""

    gbuffer_samples: int = 128
    """Uniform samples per primary ray in the gbuffer graph."""
    mesh_resolution: int = 512
    """Maximum number of cells along the longest side of the object's box."""
    faces: int = 0
    """Triangles of the simplified mesh; 0: as many as its shape needs, at most `max_faces`."""
    max_faces: int = 50_000
    """Most triangles where their number is not given; more take minutes to cut into charts."""
    atlas_size: int = 0
    """Texels along each side of the albedo texture, a multiple of 16 from `transport_size` to 8192; 0: as
    many as the photographs have pixels on the surface, a power of two from 1024 to 4096 (lite: 1024)."""
    transport_size: int = 512
    """Texels along each side of the same atlas for baked transport, roughness, metalness and normals, whose
    detail is the model's, a multiple of 16; fewer where charts fill the atlas, so that files keep their
    size."""
    albedo: typing.Literal["photographs", "model"] = "photographs"
    """Where the albedo texture's detail is from: the photographs at their full size, or the trained materials
    alone."""
    occlusion_points: int = 12_000
    """Maximum number of texels at which ambient occlusion is measured; others interpolate it."""
    occlusion_rays: int = 64
    """Secondary rays per such texel."""
    usdz: bool = False
    """Write mesh/asset.usdz too; needs the package usd-core."""
    transport_tier: str = "full"
    """Baked light transport: "full" (49 harmonics, shadow bits), "lite" (25, none) or "none"."""
    weights: str = "auto"
    """Feature tables: "fp16", "fp32", "auto" (fp16 unless it changes the model's outputs), or "none": the
    bundle carries no networks, only what was baked from them."""
    judge_samples: int = 64
    """Light directions per pixel of the refined pictures for comparison with baked ones; 0: no comparison."""
    environment_height: int = 64
    """Rows of the recovered environment; twice as many columns."""

    def __post_init__(self) -> None:
        if self.transport_tier not in ("full", "lite", "none"):
            raise ConfigError(
                f'export.transport_tier must be "full", "lite" or "none", got {self.transport_tier!r}'
            )
        if self.weights not in ("auto", "fp16", "fp32", "none"):
            raise ConfigError(
                f'export.weights must be "auto", "fp16", "fp32" or "none", got {self.weights!r}'
            )
        if self.weights == "none" and self.transport_tier == "none":
            raise ConfigError("export.weights and export.transport_tier are both none: nothing is left")
        if self.judge_samples and self.judge_samples < 2:
            raise ConfigError(f"export.judge_samples must be 0 or at least 2, got {self.judge_samples}")
        for name, most in (("atlas_size", 8192), ("transport_size", 4096)):
            size = getattr(self, name)
            if size % SIZE_STEP or not (0 if name == "atlas_size" else SIZE_STEP) <= size <= most:
                zero = ", or 0" if name == "atlas_size" else ""
                raise ConfigError(
                    f"export.{name} must be a multiple of {SIZE_STEP} texels up to {most}{zero}, got {size}"
                )
        if 0 < self.atlas_size < self.transport_size:
            raise ConfigError(
                f"export.atlas_size must be 0 or at least export.transport_size, below which charts run "
                f"together, got {self.atlas_size} and {self.transport_size}"
            )
        if self.faces and not 16 <= self.faces <= 1_000_000:
            raise ConfigError(f"export.faces must be 0 or lie in 16..1000000, got {self.faces}")
        for name, least in (("max_faces", 16), ("occlusion_points", 1), ("occlusion_rays", 1)):
            if getattr(self, name) < least:
                raise ConfigError(f"export.{name} must be at least {least}, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Config:
    """The settings of one run; the functions in `presets.py` return one."""

    preset: str
    max_side: int = 800
    """Longer photographs are reduced to this many pixels, in linear light, after `crop`."""
    crop: typing.Literal["object", "frame"] = "frame"
    """Load the part of each photograph around the object's mask, or all of it as the paper does."""
    space: SpaceConfig = field(default_factory=SpaceConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    pixels: PixelChoice = field(default_factory=PixelChoice)
    stage_one: StageOneConfig = field(default_factory=StageOneConfig)
    stage_two: StageTwoConfig = field(default_factory=StageTwoConfig)
    polish: typing.Literal["on", "off"] = "off"
    """Fit materials and light to all photographs once more after stage two, without networks: beyond the
    paper (decision 0024)."""
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    export: ExportConfig = field(default_factory=ExportConfig)
    checkpoint_steps: int = 1000
    """Steps between two checkpoints inside a stage."""
    checkpoint_interval_s: float = 300.0
    """Seconds between two checkpoints inside a stage, whichever comes first."""


def to_dict(config: Any) -> dict[str, Any]:
    """Return a configuration as plain JSON-compatible values."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_dict(cls: type[T], values: Mapping[str, Any], path: str = "") -> T:
    """Return a configuration from `to_dict`'s values; raises `ConfigError` on unknown or ill-typed ones."""
    hints = typing.get_type_hints(cls)
    names = {item.name for item in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for name in values:
        if name not in names:
            raise ConfigError(f"unknown setting {path + name!r}; known here: {', '.join(sorted(names))}")
    return cls(**{name: _convert(hints[name], values[name], path + name) for name in values})


def with_overrides(config: Config, overrides: Mapping[str, str]) -> Config:
    """Return `config` with settings changed by dotted path, as `--set stage_one.num_rays=512` does.

    Values are JSON, or bare words for strings. `export.atlas_size` alone is, where it is smaller, the size of
    transport too. Raises `ConfigError` naming the setting.
    """
    values = to_dict(config)
    for path, text in overrides.items():
        *parents, last = path.split(".")
        node = values
        for depth, name in enumerate(parents):
            if not isinstance(node, dict) or not isinstance(node.get(name), dict):
                raise ConfigError(
                    f"unknown setting {path!r}: there is no group {'.'.join(parents[: depth + 1])!r}"
                )
            node = node[name]
        if last not in node:
            raise ConfigError(f"unknown setting {path!r}; known here: {', '.join(sorted(node))}")
        try:
            node[last] = json.loads(text)
        except json.JSONDecodeError:
            node[last] = text
    size = values["export"]["atlas_size"]
    if "export.transport_size" not in overrides and type(size) is int and size > 0:
        values["export"]["transport_size"] = min(size, config.export.transport_size)
    return from_dict(Config, values)


def _convert(hint: Any, value: Any, path: str) -> Any:
    """Return `value` as the annotated type, or raise `ConfigError` with the path of the setting."""
    origin = typing.get_origin(hint)
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, Mapping):
            raise ConfigError(f"setting {path!r} is a group, got {value!r}")
        return from_dict(hint, value, path + ".")  # type: ignore[arg-type]
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in typing.get_args(hint):
            return None
        (inner,) = (option for option in typing.get_args(hint) if option is not type(None))
        return _convert(inner, value, path)
    if origin is typing.Literal:
        if value not in typing.get_args(hint):
            raise ConfigError(f"setting {path!r} must be one of {typing.get_args(hint)}, got {value!r}")
        return value
    if origin is tuple:
        options = typing.get_args(hint)
        if not isinstance(value, list | tuple):
            raise ConfigError(f"setting {path!r} is a list, got {value!r}")
        if len(options) == 2 and options[1] is Ellipsis:
            return tuple(_convert(options[0], item, path) for item in value)
        if len(options) != len(value):
            raise ConfigError(f"setting {path!r} has {len(options)} values, got {value!r}")
        return tuple(_convert(option, item, path) for option, item in zip(options, value, strict=True))
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, hint) or (hint is not bool and isinstance(value, bool)):
        raise ConfigError(f"setting {path!r} must be of type {hint.__name__}, got {value!r}")
    return value
