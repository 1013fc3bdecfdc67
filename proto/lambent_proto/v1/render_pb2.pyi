from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RenderSpec(_message.Message):
    __slots__ = ("name", "assets", "environments", "cameras", "qualities", "output")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ASSETS_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENTS_FIELD_NUMBER: _ClassVar[int]
    CAMERAS_FIELD_NUMBER: _ClassVar[int]
    QUALITIES_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    name: str
    assets: _containers.RepeatedCompositeFieldContainer[RenderAsset]
    environments: _containers.RepeatedCompositeFieldContainer[RenderEnvironment]
    cameras: _containers.RepeatedCompositeFieldContainer[RenderCameras]
    qualities: _containers.RepeatedCompositeFieldContainer[RenderQuality]
    output: RenderOutput
    def __init__(self, name: _Optional[str] = ..., assets: _Optional[_Iterable[_Union[RenderAsset, _Mapping]]] = ..., environments: _Optional[_Iterable[_Union[RenderEnvironment, _Mapping]]] = ..., cameras: _Optional[_Iterable[_Union[RenderCameras, _Mapping]]] = ..., qualities: _Optional[_Iterable[_Union[RenderQuality, _Mapping]]] = ..., output: _Optional[_Union[RenderOutput, _Mapping]] = ...) -> None: ...

class RenderAsset(_message.Message):
    __slots__ = ("name", "bundle_id", "material", "object_rotate_deg")
    NAME_FIELD_NUMBER: _ClassVar[int]
    BUNDLE_ID_FIELD_NUMBER: _ClassVar[int]
    MATERIAL_FIELD_NUMBER: _ClassVar[int]
    OBJECT_ROTATE_DEG_FIELD_NUMBER: _ClassVar[int]
    name: str
    bundle_id: str
    material: RenderMaterial
    object_rotate_deg: float
    def __init__(self, name: _Optional[str] = ..., bundle_id: _Optional[str] = ..., material: _Optional[_Union[RenderMaterial, _Mapping]] = ..., object_rotate_deg: _Optional[float] = ...) -> None: ...

class RenderMaterial(_message.Message):
    __slots__ = ("albedo_gain", "albedo", "roughness_scale")
    ALBEDO_GAIN_FIELD_NUMBER: _ClassVar[int]
    ALBEDO_FIELD_NUMBER: _ClassVar[int]
    ROUGHNESS_SCALE_FIELD_NUMBER: _ClassVar[int]
    albedo_gain: _containers.RepeatedScalarFieldContainer[float]
    albedo: _containers.RepeatedScalarFieldContainer[float]
    roughness_scale: float
    def __init__(self, albedo_gain: _Optional[_Iterable[float]] = ..., albedo: _Optional[_Iterable[float]] = ..., roughness_scale: _Optional[float] = ...) -> None: ...

class RenderEnvironment(_message.Message):
    __slots__ = ("name", "environment_id", "axes", "mend", "sun_clamp", "rotate_deg", "layout")
    NAME_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_ID_FIELD_NUMBER: _ClassVar[int]
    AXES_FIELD_NUMBER: _ClassVar[int]
    MEND_FIELD_NUMBER: _ClassVar[int]
    SUN_CLAMP_FIELD_NUMBER: _ClassVar[int]
    ROTATE_DEG_FIELD_NUMBER: _ClassVar[int]
    LAYOUT_FIELD_NUMBER: _ClassVar[int]
    name: str
    environment_id: str
    axes: str
    mend: bool
    sun_clamp: float
    rotate_deg: float
    layout: str
    def __init__(self, name: _Optional[str] = ..., environment_id: _Optional[str] = ..., axes: _Optional[str] = ..., mend: _Optional[bool] = ..., sun_clamp: _Optional[float] = ..., rotate_deg: _Optional[float] = ..., layout: _Optional[str] = ...) -> None: ...

class RenderCameras(_message.Message):
    __slots__ = ("name", "turntable", "elevation_deg", "radius", "field_of_view_deg", "start_deg", "views", "all_views", "poses", "size")
    NAME_FIELD_NUMBER: _ClassVar[int]
    TURNTABLE_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    FIELD_OF_VIEW_DEG_FIELD_NUMBER: _ClassVar[int]
    START_DEG_FIELD_NUMBER: _ClassVar[int]
    VIEWS_FIELD_NUMBER: _ClassVar[int]
    ALL_VIEWS_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    name: str
    turntable: int
    elevation_deg: float
    radius: float
    field_of_view_deg: float
    start_deg: float
    views: _containers.RepeatedScalarFieldContainer[str]
    all_views: bool
    poses: _containers.RepeatedCompositeFieldContainer[RenderCamera]
    size: int
    def __init__(self, name: _Optional[str] = ..., turntable: _Optional[int] = ..., elevation_deg: _Optional[float] = ..., radius: _Optional[float] = ..., field_of_view_deg: _Optional[float] = ..., start_deg: _Optional[float] = ..., views: _Optional[_Iterable[str]] = ..., all_views: _Optional[bool] = ..., poses: _Optional[_Iterable[_Union[RenderCamera, _Mapping]]] = ..., size: _Optional[int] = ...) -> None: ...

class RenderCamera(_message.Message):
    __slots__ = ("name", "width", "height", "focal_x", "focal_y", "centre_x", "centre_y", "camera_to_world")
    NAME_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    FOCAL_X_FIELD_NUMBER: _ClassVar[int]
    FOCAL_Y_FIELD_NUMBER: _ClassVar[int]
    CENTRE_X_FIELD_NUMBER: _ClassVar[int]
    CENTRE_Y_FIELD_NUMBER: _ClassVar[int]
    CAMERA_TO_WORLD_FIELD_NUMBER: _ClassVar[int]
    name: str
    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    camera_to_world: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., width: _Optional[int] = ..., height: _Optional[int] = ..., focal_x: _Optional[float] = ..., focal_y: _Optional[float] = ..., centre_x: _Optional[float] = ..., centre_y: _Optional[float] = ..., camera_to_world: _Optional[_Iterable[float]] = ...) -> None: ...

class RenderQuality(_message.Message):
    __slots__ = ("name", "quality", "spp", "until_stderr", "antialias", "indirect", "seed", "background", "exposure_ev", "bounces", "tone_mapping", "occlusion", "denoise")
    NAME_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    SPP_FIELD_NUMBER: _ClassVar[int]
    UNTIL_STDERR_FIELD_NUMBER: _ClassVar[int]
    ANTIALIAS_FIELD_NUMBER: _ClassVar[int]
    INDIRECT_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    BACKGROUND_FIELD_NUMBER: _ClassVar[int]
    EXPOSURE_EV_FIELD_NUMBER: _ClassVar[int]
    BOUNCES_FIELD_NUMBER: _ClassVar[int]
    TONE_MAPPING_FIELD_NUMBER: _ClassVar[int]
    OCCLUSION_FIELD_NUMBER: _ClassVar[int]
    DENOISE_FIELD_NUMBER: _ClassVar[int]
    name: str
    quality: str
    spp: int
    until_stderr: float
    antialias: int
    indirect: bool
    seed: int
    background: str
    exposure_ev: float
    bounces: str
    tone_mapping: str
    occlusion: str
    denoise: bool
    def __init__(self, name: _Optional[str] = ..., quality: _Optional[str] = ..., spp: _Optional[int] = ..., until_stderr: _Optional[float] = ..., antialias: _Optional[int] = ..., indirect: _Optional[bool] = ..., seed: _Optional[int] = ..., background: _Optional[str] = ..., exposure_ev: _Optional[float] = ..., bounces: _Optional[str] = ..., tone_mapping: _Optional[str] = ..., occlusion: _Optional[str] = ..., denoise: _Optional[bool] = ...) -> None: ...

class RenderOutput(_message.Message):
    __slots__ = ("files", "passes", "half", "path")
    FILES_FIELD_NUMBER: _ClassVar[int]
    PASSES_FIELD_NUMBER: _ClassVar[int]
    HALF_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    files: _containers.RepeatedScalarFieldContainer[str]
    passes: _containers.RepeatedScalarFieldContainer[str]
    half: bool
    path: str
    def __init__(self, files: _Optional[_Iterable[str]] = ..., passes: _Optional[_Iterable[str]] = ..., half: _Optional[bool] = ..., path: _Optional[str] = ...) -> None: ...

class RenderTask(_message.Message):
    __slots__ = ("spec", "shard", "num_shards", "failures")
    SPEC_FIELD_NUMBER: _ClassVar[int]
    SHARD_FIELD_NUMBER: _ClassVar[int]
    NUM_SHARDS_FIELD_NUMBER: _ClassVar[int]
    FAILURES_FIELD_NUMBER: _ClassVar[int]
    spec: RenderSpec
    shard: int
    num_shards: int
    failures: _containers.RepeatedCompositeFieldContainer[RenderFailure]
    def __init__(self, spec: _Optional[_Union[RenderSpec, _Mapping]] = ..., shard: _Optional[int] = ..., num_shards: _Optional[int] = ..., failures: _Optional[_Iterable[_Union[RenderFailure, _Mapping]]] = ...) -> None: ...

class RenderFailure(_message.Message):
    __slots__ = ("path", "code", "message")
    PATH_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    path: str
    code: str
    message: str
    def __init__(self, path: _Optional[str] = ..., code: _Optional[str] = ..., message: _Optional[str] = ...) -> None: ...
