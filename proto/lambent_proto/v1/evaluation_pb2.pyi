from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class EvaluationReport(_message.Message):
    __slots__ = ("schema_version", "protocol_version", "scene", "preset", "seed", "num_views", "num_secondary_rays", "num_repeats", "metrics", "albedo_ratio_rgb", "seconds", "notes", "protocol", "absent", "dataset", "object_group", "published", "albedo_ratio_least_squares_rgb", "train_lights", "antialias")
    class SecondsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    SCHEMA_VERSION_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    SCENE_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    NUM_VIEWS_FIELD_NUMBER: _ClassVar[int]
    NUM_SECONDARY_RAYS_FIELD_NUMBER: _ClassVar[int]
    NUM_REPEATS_FIELD_NUMBER: _ClassVar[int]
    METRICS_FIELD_NUMBER: _ClassVar[int]
    ALBEDO_RATIO_RGB_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_FIELD_NUMBER: _ClassVar[int]
    ABSENT_FIELD_NUMBER: _ClassVar[int]
    DATASET_FIELD_NUMBER: _ClassVar[int]
    OBJECT_GROUP_FIELD_NUMBER: _ClassVar[int]
    PUBLISHED_FIELD_NUMBER: _ClassVar[int]
    ALBEDO_RATIO_LEAST_SQUARES_RGB_FIELD_NUMBER: _ClassVar[int]
    TRAIN_LIGHTS_FIELD_NUMBER: _ClassVar[int]
    ANTIALIAS_FIELD_NUMBER: _ClassVar[int]
    schema_version: str
    protocol_version: str
    scene: str
    preset: str
    seed: int
    num_views: int
    num_secondary_rays: int
    num_repeats: int
    metrics: _containers.RepeatedCompositeFieldContainer[Metric]
    albedo_ratio_rgb: _containers.RepeatedScalarFieldContainer[float]
    seconds: _containers.ScalarMap[str, float]
    notes: _containers.RepeatedScalarFieldContainer[str]
    protocol: _containers.RepeatedScalarFieldContainer[str]
    absent: _containers.RepeatedCompositeFieldContainer[AbsentMetric]
    dataset: str
    object_group: str
    published: _containers.RepeatedCompositeFieldContainer[PublishedResult]
    albedo_ratio_least_squares_rgb: _containers.RepeatedScalarFieldContainer[float]
    train_lights: _containers.RepeatedScalarFieldContainer[str]
    antialias: int
    def __init__(self, schema_version: _Optional[str] = ..., protocol_version: _Optional[str] = ..., scene: _Optional[str] = ..., preset: _Optional[str] = ..., seed: _Optional[int] = ..., num_views: _Optional[int] = ..., num_secondary_rays: _Optional[int] = ..., num_repeats: _Optional[int] = ..., metrics: _Optional[_Iterable[_Union[Metric, _Mapping]]] = ..., albedo_ratio_rgb: _Optional[_Iterable[float]] = ..., seconds: _Optional[_Mapping[str, float]] = ..., notes: _Optional[_Iterable[str]] = ..., protocol: _Optional[_Iterable[str]] = ..., absent: _Optional[_Iterable[_Union[AbsentMetric, _Mapping]]] = ..., dataset: _Optional[str] = ..., object_group: _Optional[str] = ..., published: _Optional[_Iterable[_Union[PublishedResult, _Mapping]]] = ..., albedo_ratio_least_squares_rgb: _Optional[_Iterable[float]] = ..., train_lights: _Optional[_Iterable[str]] = ..., antialias: _Optional[int] = ...) -> None: ...

class Metric(_message.Message):
    __slots__ = ("name", "value", "unit", "standard_error")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    STANDARD_ERROR_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    unit: str
    standard_error: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ..., unit: _Optional[str] = ..., standard_error: _Optional[float] = ...) -> None: ...

class AbsentMetric(_message.Message):
    __slots__ = ("name", "reason")
    NAME_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    name: str
    reason: str
    def __init__(self, name: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class PublishedResult(_message.Message):
    __slots__ = ("method", "values")
    class ValuesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    METHOD_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    method: str
    values: _containers.ScalarMap[str, float]
    def __init__(self, method: _Optional[str] = ..., values: _Optional[_Mapping[str, float]] = ...) -> None: ...
