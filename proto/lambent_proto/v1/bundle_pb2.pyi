from lambent_proto.v1 import scene_pb2 as _scene_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class BundleManifest(_message.Message):
    __slots__ = ("schema_version", "scene_id", "name", "created_at", "generator", "preset", "train_lights", "world", "bounds", "secondary_rays", "files", "graphs", "grids", "tensors", "albedo_scale_rgb", "metrics", "uncertainty", "atlas", "transport", "mesh_levels", "given_mesh")
    class MetricsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCENE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    GENERATOR_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    TRAIN_LIGHTS_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    BOUNDS_FIELD_NUMBER: _ClassVar[int]
    SECONDARY_RAYS_FIELD_NUMBER: _ClassVar[int]
    FILES_FIELD_NUMBER: _ClassVar[int]
    GRAPHS_FIELD_NUMBER: _ClassVar[int]
    GRIDS_FIELD_NUMBER: _ClassVar[int]
    TENSORS_FIELD_NUMBER: _ClassVar[int]
    ALBEDO_SCALE_RGB_FIELD_NUMBER: _ClassVar[int]
    METRICS_FIELD_NUMBER: _ClassVar[int]
    UNCERTAINTY_FIELD_NUMBER: _ClassVar[int]
    ATLAS_FIELD_NUMBER: _ClassVar[int]
    TRANSPORT_FIELD_NUMBER: _ClassVar[int]
    MESH_LEVELS_FIELD_NUMBER: _ClassVar[int]
    GIVEN_MESH_FIELD_NUMBER: _ClassVar[int]
    schema_version: str
    scene_id: str
    name: str
    created_at: str
    generator: Generator
    preset: str
    train_lights: _containers.RepeatedScalarFieldContainer[str]
    world: World
    bounds: _scene_pb2.Bounds
    secondary_rays: SecondaryRays
    files: _containers.RepeatedCompositeFieldContainer[BundleFile]
    graphs: _containers.RepeatedCompositeFieldContainer[Graph]
    grids: _containers.RepeatedCompositeFieldContainer[Grid]
    tensors: _containers.RepeatedCompositeFieldContainer[TensorEntry]
    albedo_scale_rgb: _containers.RepeatedScalarFieldContainer[float]
    metrics: _containers.ScalarMap[str, float]
    uncertainty: Uncertainty
    atlas: Atlas
    transport: Transport
    mesh_levels: _containers.RepeatedCompositeFieldContainer[MeshLevel]
    given_mesh: GivenMesh
    def __init__(self, schema_version: _Optional[str] = ..., scene_id: _Optional[str] = ..., name: _Optional[str] = ..., created_at: _Optional[str] = ..., generator: _Optional[_Union[Generator, _Mapping]] = ..., preset: _Optional[str] = ..., train_lights: _Optional[_Iterable[str]] = ..., world: _Optional[_Union[World, _Mapping]] = ..., bounds: _Optional[_Union[_scene_pb2.Bounds, _Mapping]] = ..., secondary_rays: _Optional[_Union[SecondaryRays, _Mapping]] = ..., files: _Optional[_Iterable[_Union[BundleFile, _Mapping]]] = ..., graphs: _Optional[_Iterable[_Union[Graph, _Mapping]]] = ..., grids: _Optional[_Iterable[_Union[Grid, _Mapping]]] = ..., tensors: _Optional[_Iterable[_Union[TensorEntry, _Mapping]]] = ..., albedo_scale_rgb: _Optional[_Iterable[float]] = ..., metrics: _Optional[_Mapping[str, float]] = ..., uncertainty: _Optional[_Union[Uncertainty, _Mapping]] = ..., atlas: _Optional[_Union[Atlas, _Mapping]] = ..., transport: _Optional[_Union[Transport, _Mapping]] = ..., mesh_levels: _Optional[_Iterable[_Union[MeshLevel, _Mapping]]] = ..., given_mesh: _Optional[_Union[GivenMesh, _Mapping]] = ...) -> None: ...

class GivenMesh(_message.Message):
    __slots__ = ("name", "sha256", "kept_uv", "share_from_model")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    KEPT_UV_FIELD_NUMBER: _ClassVar[int]
    SHARE_FROM_MODEL_FIELD_NUMBER: _ClassVar[int]
    name: str
    sha256: str
    kept_uv: bool
    share_from_model: float
    def __init__(self, name: _Optional[str] = ..., sha256: _Optional[str] = ..., kept_uv: _Optional[bool] = ..., share_from_model: _Optional[float] = ...) -> None: ...

class MeshLevel(_message.Message):
    __slots__ = ("path", "num_faces", "texture_size")
    PATH_FIELD_NUMBER: _ClassVar[int]
    NUM_FACES_FIELD_NUMBER: _ClassVar[int]
    TEXTURE_SIZE_FIELD_NUMBER: _ClassVar[int]
    path: str
    num_faces: int
    texture_size: int
    def __init__(self, path: _Optional[str] = ..., num_faces: _Optional[int] = ..., texture_size: _Optional[int] = ...) -> None: ...

class Generator(_message.Message):
    __slots__ = ("name", "version", "git_revision", "train_step")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    GIT_REVISION_FIELD_NUMBER: _ClassVar[int]
    TRAIN_STEP_FIELD_NUMBER: _ClassVar[int]
    name: str
    version: str
    git_revision: str
    train_step: int
    def __init__(self, name: _Optional[str] = ..., version: _Optional[str] = ..., git_revision: _Optional[str] = ..., train_step: _Optional[int] = ...) -> None: ...

class World(_message.Message):
    __slots__ = ("up_axis", "handedness", "unit", "environment_convention", "radiance")
    UP_AXIS_FIELD_NUMBER: _ClassVar[int]
    HANDEDNESS_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    ENVIRONMENT_CONVENTION_FIELD_NUMBER: _ClassVar[int]
    RADIANCE_FIELD_NUMBER: _ClassVar[int]
    up_axis: str
    handedness: str
    unit: str
    environment_convention: str
    radiance: str
    def __init__(self, up_axis: _Optional[str] = ..., handedness: _Optional[str] = ..., unit: _Optional[str] = ..., environment_convention: _Optional[str] = ..., radiance: _Optional[str] = ...) -> None: ...

class Atlas(_message.Message):
    __slots__ = ("size", "texel_size", "material_size", "albedo_source", "unseen_path")
    SIZE_FIELD_NUMBER: _ClassVar[int]
    TEXEL_SIZE_FIELD_NUMBER: _ClassVar[int]
    MATERIAL_SIZE_FIELD_NUMBER: _ClassVar[int]
    ALBEDO_SOURCE_FIELD_NUMBER: _ClassVar[int]
    UNSEEN_PATH_FIELD_NUMBER: _ClassVar[int]
    size: int
    texel_size: float
    material_size: int
    albedo_source: str
    unseen_path: str
    def __init__(self, size: _Optional[int] = ..., texel_size: _Optional[float] = ..., material_size: _Optional[int] = ..., albedo_source: _Optional[str] = ..., unseen_path: _Optional[str] = ...) -> None: ...

class SecondaryRays(_message.Message):
    __slots__ = ("origin_offset", "near", "far")
    ORIGIN_OFFSET_FIELD_NUMBER: _ClassVar[int]
    NEAR_FIELD_NUMBER: _ClassVar[int]
    FAR_FIELD_NUMBER: _ClassVar[int]
    origin_offset: float
    near: float
    far: float
    def __init__(self, origin_offset: _Optional[float] = ..., near: _Optional[float] = ..., far: _Optional[float] = ...) -> None: ...

class BundleFile(_message.Message):
    __slots__ = ("path", "size_bytes", "sha256", "role")
    PATH_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    path: str
    size_bytes: float
    sha256: str
    role: str
    def __init__(self, path: _Optional[str] = ..., size_bytes: _Optional[float] = ..., sha256: _Optional[str] = ..., role: _Optional[str] = ...) -> None: ...

class Graph(_message.Message):
    __slots__ = ("name", "path", "light", "parity", "rounding")
    NAME_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    LIGHT_FIELD_NUMBER: _ClassVar[int]
    PARITY_FIELD_NUMBER: _ClassVar[int]
    ROUNDING_FIELD_NUMBER: _ClassVar[int]
    name: str
    path: str
    light: str
    parity: Parity
    rounding: _containers.RepeatedCompositeFieldContainer[Rounding]
    def __init__(self, name: _Optional[str] = ..., path: _Optional[str] = ..., light: _Optional[str] = ..., parity: _Optional[_Union[Parity, _Mapping]] = ..., rounding: _Optional[_Iterable[_Union[Rounding, _Mapping]]] = ...) -> None: ...

class Rounding(_message.Message):
    __slots__ = ("output", "max_abs_error", "rms_error", "num_samples")
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    MAX_ABS_ERROR_FIELD_NUMBER: _ClassVar[int]
    RMS_ERROR_FIELD_NUMBER: _ClassVar[int]
    NUM_SAMPLES_FIELD_NUMBER: _ClassVar[int]
    output: str
    max_abs_error: float
    rms_error: float
    num_samples: int
    def __init__(self, output: _Optional[str] = ..., max_abs_error: _Optional[float] = ..., rms_error: _Optional[float] = ..., num_samples: _Optional[int] = ...) -> None: ...

class Uncertainty(_message.Message):
    __slots__ = ("path", "box", "channels")
    PATH_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    path: str
    box: _scene_pb2.Bounds
    channels: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, path: _Optional[str] = ..., box: _Optional[_Union[_scene_pb2.Bounds, _Mapping]] = ..., channels: _Optional[_Iterable[str]] = ...) -> None: ...

class Transport(_message.Message):
    __slots__ = ("size", "num_texels", "texels_path", "planes", "shadow_bits_path", "num_shadow_directions")
    SIZE_FIELD_NUMBER: _ClassVar[int]
    NUM_TEXELS_FIELD_NUMBER: _ClassVar[int]
    TEXELS_PATH_FIELD_NUMBER: _ClassVar[int]
    PLANES_FIELD_NUMBER: _ClassVar[int]
    SHADOW_BITS_PATH_FIELD_NUMBER: _ClassVar[int]
    NUM_SHADOW_DIRECTIONS_FIELD_NUMBER: _ClassVar[int]
    size: int
    num_texels: int
    texels_path: str
    planes: _containers.RepeatedCompositeFieldContainer[TransportPlanes]
    shadow_bits_path: str
    num_shadow_directions: int
    def __init__(self, size: _Optional[int] = ..., num_texels: _Optional[int] = ..., texels_path: _Optional[str] = ..., planes: _Optional[_Iterable[_Union[TransportPlanes, _Mapping]]] = ..., shadow_bits_path: _Optional[str] = ..., num_shadow_directions: _Optional[int] = ...) -> None: ...

class TransportPlanes(_message.Message):
    __slots__ = ("name", "path", "bands", "channels", "scales", "offsets")
    NAME_FIELD_NUMBER: _ClassVar[int]
    PATH_FIELD_NUMBER: _ClassVar[int]
    BANDS_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    SCALES_FIELD_NUMBER: _ClassVar[int]
    OFFSETS_FIELD_NUMBER: _ClassVar[int]
    name: str
    path: str
    bands: int
    channels: int
    scales: _containers.RepeatedScalarFieldContainer[float]
    offsets: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., path: _Optional[str] = ..., bands: _Optional[int] = ..., channels: _Optional[int] = ..., scales: _Optional[_Iterable[float]] = ..., offsets: _Optional[_Iterable[float]] = ...) -> None: ...

class Parity(_message.Message):
    __slots__ = ("max_abs_error", "tolerance", "num_samples")
    MAX_ABS_ERROR_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    NUM_SAMPLES_FIELD_NUMBER: _ClassVar[int]
    max_abs_error: float
    tolerance: float
    num_samples: int
    def __init__(self, max_abs_error: _Optional[float] = ..., tolerance: _Optional[float] = ..., num_samples: _Optional[int] = ...) -> None: ...

class Grid(_message.Message):
    __slots__ = ("name", "tensor", "num_features", "half_extent", "levels")
    NAME_FIELD_NUMBER: _ClassVar[int]
    TENSOR_FIELD_NUMBER: _ClassVar[int]
    NUM_FEATURES_FIELD_NUMBER: _ClassVar[int]
    HALF_EXTENT_FIELD_NUMBER: _ClassVar[int]
    LEVELS_FIELD_NUMBER: _ClassVar[int]
    name: str
    tensor: str
    num_features: int
    half_extent: float
    levels: _containers.RepeatedCompositeFieldContainer[GridLevel]
    def __init__(self, name: _Optional[str] = ..., tensor: _Optional[str] = ..., num_features: _Optional[int] = ..., half_extent: _Optional[float] = ..., levels: _Optional[_Iterable[_Union[GridLevel, _Mapping]]] = ...) -> None: ...

class GridLevel(_message.Message):
    __slots__ = ("resolution", "first_row", "num_rows", "multiplier_y", "multiplier_z")
    RESOLUTION_FIELD_NUMBER: _ClassVar[int]
    FIRST_ROW_FIELD_NUMBER: _ClassVar[int]
    NUM_ROWS_FIELD_NUMBER: _ClassVar[int]
    MULTIPLIER_Y_FIELD_NUMBER: _ClassVar[int]
    MULTIPLIER_Z_FIELD_NUMBER: _ClassVar[int]
    resolution: int
    first_row: int
    num_rows: int
    multiplier_y: int
    multiplier_z: int
    def __init__(self, resolution: _Optional[int] = ..., first_row: _Optional[int] = ..., num_rows: _Optional[int] = ..., multiplier_y: _Optional[int] = ..., multiplier_z: _Optional[int] = ...) -> None: ...

class TensorEntry(_message.Message):
    __slots__ = ("name", "dtype", "shape", "offset_bytes", "size_bytes")
    NAME_FIELD_NUMBER: _ClassVar[int]
    DTYPE_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    OFFSET_BYTES_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    name: str
    dtype: str
    shape: _containers.RepeatedScalarFieldContainer[int]
    offset_bytes: float
    size_bytes: float
    def __init__(self, name: _Optional[str] = ..., dtype: _Optional[str] = ..., shape: _Optional[_Iterable[int]] = ..., offset_bytes: _Optional[float] = ..., size_bytes: _Optional[float] = ...) -> None: ...
